// An ASCET model as the function: its source text, what can be chosen of it and what stops it, and its formula text.

import { Icon } from "../../icons";
import { ErrorSplit, placeText, split } from "../../instruments/error-split";
import type { FormulaLine } from "../../replies";
import { request, state } from "../../store";
import { Fold } from "./fold";
import { FormulaLines } from "./formula-lines";
import { FunctionChoice } from "./function-choice";
import { ProgramState } from "./program-state";
import { ProgramText, showPlace } from "./program-text";
import { FunctionSettings } from "./settings";
import { chosen, program } from "./source";

export function Ascet() {
  const own = program.value;
  const stops = own?.problems.length ?? 0;
  return (
    <main class="function simulink ascet">
      <section class="pane blocks">
        <div class="head">
          <FunctionChoice />
          {own !== null && (
            <span class="right">
              {own.whole ? <span class="tag g">can be calibrated</span> : <span class="tag b">{stops} to solve</span>}
            </span>
          )}
        </div>
        <ProgramText />
      </section>
      <section class="pane state">
        <div class="head">
          <h2>Import</h2>
          <span class="sub">what is calculated, and what stops it</span>
        </div>
        <div class="scroll">
          <ProgramState />
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
            title="Read all files again, after they have changed on disk"
            onClick={() => request("reread-function")}
          >
            Read again
          </button>
        </div>
      </section>
      <section class="pane lines">
        <FormulaLines
          lines={own?.lines}
          tables={(own?.parameters ?? []).map((each) => each.name)}
          part="this line"
          alone="No line of the formula text calculates what is declared in the chosen line."
          lit={isLit}
          go={showPlace}
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

const isLit = (line: FormulaLine): boolean => line.path !== "" && line.path === chosen.value;

/** Messages of the check that the import does not report itself; a click goes to the line. */
function Findings() {
  const { sources = [], problems = [], notes = [] } = program.value ?? {};
  const own = state.value.findings.filter(
    (each) =>
      each.screen === "function" &&
      !problems.some((problem) => each.text.includes(problem.message)) &&
      !notes.some((note) => each.text.endsWith(note)),
  );
  if (own.length === 0) return null;
  return (
    <div class="cks" role="list" aria-label="Messages">
      {own.map((each) => {
        const source = sources.findIndex(({ file }) => file === each.file || file.endsWith(`/${each.file}`));
        return (
          <div class={`ck ${each.severity === "remark" ? "i" : "w"}`} role="listitem">
            <Icon name={each.severity === "remark" ? "find" : "warning"} />
            {source >= 0 && each.line > 0 ? (
              <button class="grow link plain" title="Show the line" onClick={() => showPlace(`${source}:${each.line}`)}>
                {each.text}
              </button>
            ) : (
              <span class="grow">{each.text}</span>
            )}
          </div>
        );
      })}
    </div>
  );
}
