// A function in a file of another tool as the function of the project: its source text or description, its ports, what
// stops it.

import { isAsked } from "../../code-consent";
import { Icon } from "../../icons";
import { ErrorSplit, placeText, split } from "../../instruments/error-split";
import type { ProjectFunction } from "../../replies";
import { request, state } from "../../store";
import { CodeText } from "./code-text";
import { fileFunction } from "./file-source";
import { FileState } from "./file-state";
import { Fold } from "./fold";
import { FormulaLines } from "./formula-lines";
import { FunctionChoice } from "./function-choice";
import { FunctionSettings } from "./settings";
import { addLibraries } from "./source";

export function FileFunction() {
  const own = fileFunction.value;
  const hasLines = (own?.lines?.length ?? 0) > 0;
  return (
    <main class="function simulink ascet">
      <section class="pane blocks">
        <div class="head">
          <FunctionChoice />
          {own !== null && (
            <span class="right">
              <Verdict own={own} />
            </span>
          )}
        </div>
        {own !== null && (own.named ? <CodeText own={own} /> : <Facts own={own} />)}
      </section>
      <section class="pane state">
        <div class="head">
          <h2>Import</h2>
          <span class="sub">what it reads and returns, and what stops it</span>
        </div>
        <div class="scroll">
          <FileState />
        </div>
        <div class="foot">
          <button
            class="btn primary"
            disabled={!hasLines}
            title={
              own?.whole && !hasLines
                ? withoutText(own)
                : "Write the function as formula text, with the values of its parameters, and use that as the function\n[model] file"
            }
            onClick={() => request("convert-function")}
          >
            Edit as formula text
          </button>
          <button
            class="btn"
            title="Read the file again, after it has changed on disk"
            onClick={() => request("reread-function")}
          >
            Read again
          </button>
          {/\.c$/i.test(own?.file ?? "") && (
            <label class="btn" title="Files that it includes, and its file of data; they are stored beside it">
              Add files
              <input
                type="file"
                multiple
                accept=".h,.c"
                aria-label="Included files"
                hidden
                onChange={(event) => {
                  void addLibraries([...(event.currentTarget.files ?? [])]);
                  event.currentTarget.value = "";
                }}
              />
            </label>
          )}
        </div>
      </section>
      <section class="pane lines">
        {own?.whole && !hasLines ? (
          <Values own={own} />
        ) : (
          <>
            <FormulaLines lines={own?.lines} tables={(own?.parameters ?? []).map((each) => each.name)} />
            <Fold title="At the cursor" sub={split.value ? placeText(split.value) : ""} name="cursor">
              <ErrorSplit />
            </Fold>
          </>
        )}
        <Findings own={own} />
        <FunctionSettings />
      </section>
    </main>
  );
}

/** True if code has to be allowed before anything is evaluated. */
const isPending = (): boolean => state.value.code.length > 0;

function Verdict({ own }: { own: ProjectFunction }) {
  if (own.whole && isPending()) return <span class="tag w">runs code</span>;
  if (own.whole) return <span class="tag g">can be calibrated</span>;
  return own.problems.length > 0 ? (
    <span class="tag b">{own.problems.length} to solve</span>
  ) : (
    <span class="tag w">choose a function</span>
  );
}

const withoutText = (own: ProjectFunction): string =>
  own.runs
    ? `The code of ${own.file} is called at each step, which formula text cannot express.`
    : "Formula text cannot express the layers of a network.";

/** The outputs at the cursor, for a function that has no formula text. */
function Values({ own }: { own: ProjectFunction }) {
  return (
    <div class="scroll grow">
      <div class="head">
        <h2>At the cursor</h2>
        <span class="sub">{split.value && !isPending() ? placeText(split.value) : ""}</span>
      </div>
      {isPending() ? <p class="pad q">Values are shown once the code may run.</p> : <ErrorSplit nodes />}
      <p class="pad q">{withoutText(own)}</p>
    </div>
  );
}

/** What the file of an FMU or a network says of itself. */
function Facts({ own }: { own: ProjectFunction }) {
  return (
    <>
      <div class="head mid">
        <h2>{own.file}</h2>
        <span class="sub">{own.kind}</span>
      </div>
      <dl class="facts pad">
        {own.facts
          .filter(([, text]) => text)
          .map(([name, text]) => (
            <>
              <dt>{name}</dt>
              <dd title={text}>{text}</dd>
            </>
          ))}
      </dl>
      {own.facts.length === 0 && <p class="pad q">The file cannot be read.</p>}
    </>
  );
}

/** Messages of the check that the pane in the middle does not show. */
function Findings({ own }: { own: ProjectFunction | null }) {
  const known = [...(own?.problems ?? []).map((each) => each.message), ...(own?.notes ?? [])];
  const others = state.value.findings.filter(
    (each) =>
      each.screen === "function" &&
      !isAsked(each) &&
      (own?.whole || each.file !== own?.file) &&
      !known.some((text) => each.text.includes(text) || text.includes(each.message)),
  );
  if (others.length === 0) return null;
  return (
    <div class="cks" role="list" aria-label="Messages">
      {others.map((each) => (
        <div class={`ck ${each.severity === "remark" ? "i" : "w"}`} role="listitem">
          <Icon name={each.severity === "remark" ? "find" : "warning"} />
          <span class="grow">{each.text}</span>
        </div>
      ))}
    </div>
  );
}
