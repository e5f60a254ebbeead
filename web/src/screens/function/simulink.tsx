// A Simulink model as the function: its blocks, what it needs and what stops it, and the formula text that it becomes.

import { count } from "../../drawing/numbers";
import { Icon } from "../../icons";
import { ErrorSplit, placeText, split } from "../../instruments/error-split";
import type { FormulaLine } from "../../replies";
import { setKeys } from "../../settings";
import { request, state } from "../../store";
import { BlockActions } from "./block-actions";
import { BlockTree, reveal } from "./block-tree";
import { Fold } from "./fold";
import { FormulaLines } from "./formula-lines";
import { FunctionChoice } from "./function-choice";
import { ImportState } from "./import-state";
import { FunctionSettings } from "./settings";
import { chosen, diagram, parts } from "./source";

const isOf = (line: FormulaLine, path: string): boolean =>
  path !== "" && line.path !== "" && (line.path === path || line.path.startsWith(`${path}/`));

export function Simulink() {
  const own = diagram.value;
  const bound = Object.keys(own?.bind ?? {}).length;
  const stopping =
    (own?.blocking ?? []).filter((block) => block.stops).length +
    (own?.undefined?.length ?? 0) +
    (own?.loops?.length ?? 0) +
    (own?.problems.length ?? 0);
  return (
    <main class="function simulink">
      <section class="pane blocks">
        <div class="head">
          <FunctionChoice />
          {own?.total !== undefined && (
            <span class="right">
              <span class={`tag ${own.whole ? "g" : "w"}`} title={[own.solver, own.version].filter(Boolean).join(", ")}>
                {own.supported} of {count(own.total)} supported{own.unreached ? `, ${own.unreached} not reached` : ""}
              </span>
            </span>
          )}
        </div>
        <BlockTree />
        <BlockActions />
        <PartChoice />
      </section>
      <section class="pane state">
        <div class="head">
          <h2>What stops it</h2>
          <span class="right">
            {stopping > 0 ? (
              <span class="tag b">{stopping} to solve</span>
            ) : (
              own !== null && <span class="tag g">{bound ? `${bound} bound` : "nothing"}</span>
            )}
          </span>
        </div>
        <div class="scroll">
          <ImportState />
        </div>
        <div class="foot">
          <button
            class="btn primary"
            disabled={!own?.whole}
            title="Write the imported part as formula text, with the values of its parameters, and use that as the function&#10;[model] file"
            onClick={() => request("convert-function")}
          >
            Edit as formula text
          </button>
          <button
            class="btn"
            title="Read the model, its libraries and its files of values again, after they have changed on disk"
            onClick={() => request("reread-function")}
          >
            Read again
          </button>
          <span class="right q">
            {own?.parameters ? `${own.parameters.length} parameter${own.parameters.length === 1 ? "" : "s"}` : ""}
          </span>
        </div>
      </section>
      <section class="pane lines">
        <FormulaLines
          lines={own?.lines}
          tables={(own?.parameters ?? []).map((each) => each.name)}
          part="this block"
          alone="No line comes from this block alone: it is part of other lines, or only passes a signal on."
          lit={(line) => isOf(line, chosen.value)}
          go={reveal}
        />
        <Fold title="At the cursor" sub={split.value ? placeText(split.value) : ""} name="cursor">
          <ErrorSplit />
        </Fold>
        <Findings />
        <FunctionSettings />
      </section>
    </main>
  );
}

/** Messages of the check that are not about the model file itself. */
function Findings() {
  const own = state.value.findings.filter((each) => each.screen === "function" && each.file !== diagram.value?.file);
  if (own.length === 0) return null;
  return (
    <div class="cks">
      {own.map((each) => (
        <div class={`ck ${each.severity === "remark" ? "i" : "w"}`}>
          <Icon name={each.severity === "remark" ? "find" : "warning"} />
          <span class="grow">{each.text}</span>
        </div>
      ))}
    </div>
  );
}

/** The part of the model that is imported. */
function PartChoice() {
  const own = diagram.value;
  if (own?.blocks === undefined && !own?.subsystem) return null;
  const alone = parts.value ?? [];
  const others = (own.subsystems ?? []).filter((path) => !alone.some((part) => part.path === path));
  const part = alone.find((each) => each.path === (own.subsystem || chosen.value));
  return (
    <div class="model-part">
      <label class="q" for="part">
        Take only a part
      </label>
      <select
        id="part"
        class="field"
        title="The subsystem that is the function&#10;[model] subsystem"
        value={own.subsystem}
        onChange={(event) => {
          const path = event.currentTarget.value;
          void setKeys(
            [[["model", "subsystem"], path || null]],
            path ? `Only ${path} is imported` : "The whole model is imported",
          );
        }}
      >
        <option value="">the whole model</option>
        <optgroup label="can be imported by itself">
          {alone.map((each) => (
            <option value={each.path}>
              {each.path} ({each.blocks} blocks)
            </option>
          ))}
        </optgroup>
        <optgroup label="needs variables or bindings">
          {others.map((path) => (
            <option value={path}>{path}</option>
          ))}
        </optgroup>
      </select>
      <p class="q">
        {part
          ? `${part.path} can be imported by itself: ${part.inputs.join(", ") || "no inputs"} to ${part.outputs.join(", ")}.`
          : parts.value === null
            ? "Searching for parts"
            : `${alone.length === 1 ? "1 subsystem" : `${alone.length} subsystems`} can be imported alone.`}
      </p>
    </div>
  );
}
