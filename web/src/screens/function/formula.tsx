// Formula text as the function: the editor, its messages, and what the error at the cursor is made of.

import type { JSX } from "preact";
import { useEffect, useLayoutEffect, useState } from "preact/hooks";
import { CodeConsent } from "../../code-consent";
import { unitText } from "../../drawing/numbers";
import { Corrections, split } from "../../instruments/error-split";
import { Proposals } from "../../instruments/proposals";
import { scoped } from "../../scope";
import { settings } from "../../settings";
import { open, request, screen, state } from "../../store";
import { CalledFunctions } from "./called-functions";
import { CursorPane, step } from "./cursor-pane";
import { SignalFlow } from "./flow";
import { Fold } from "./fold";
import { FunctionChoice, OpenModel } from "./function-choice";
import { Messages } from "./messages";
import { NodeStrip } from "./node-strip";
import { FunctionSettings } from "./settings";
import { chosen } from "./source";
import { Surrogates } from "./surrogates";

const text = scoped<"function" | "project">("function");

export function FormulaText() {
  const { file } = settings.value;
  const own = text.value === "function" ? file : "";
  useLayoutEffect(() => {
    addEventListener("keydown", key, true); // before the editor, which moves lines with these keys
    return () => removeEventListener("keydown", key, true);
  }, []);
  return (
    <main class="function formula">
      <section class="pane text">
        <div class="head">
          {own ? <FunctionChoice /> : <h2>Project file</h2>}
          <span class="right">
            <span class="seg tight" role="group" aria-label="Text">
              <button
                aria-pressed={text.value === "function"}
                onClick={() => {
                  text.value = "function";
                }}
              >
                Function
              </button>
              <button
                aria-pressed={text.value === "project"}
                data-text="project"
                onClick={() => {
                  text.value = "project";
                }}
              >
                Project file
              </button>
            </span>
          </span>
        </div>
        {own !== "" && (
          <div class="ln hd">
            <i />
            <code>node [unit] = expression</code>
            <span class="u">unit</span>
            <span class="num">start</span>
            <span class="num">now</span>
          </div>
        )}
        {text.value === "function" && file === "" ? <NoFunction /> : <LazyEditor key={own} file={own} />}
        <CodeConsent />
        <Messages />
      </section>
      <CursorPane />
      <section class="pane nodes">
        <div class="head">
          <h2>Signal flow</h2>
          <span class="sub">values at the cursor</span>
          {chosen.value && (
            <span class="right key">
              <i style={{ borderColor: "var(--lit)" }} />
              what {chosen.value} reads and feeds
            </span>
          )}
        </div>
        <SignalFlow />
        <NodeStrip />
        <div class="head mid">
          <h2>What would take this error away</h2>
          <span class="sub">one table at a time</span>
        </div>
        {split.value !== null && (
          <div class="split">
            <Corrections
              own={split.value}
              chosen={chosen.value}
              choose={(node) => {
                chosen.value = node;
              }}
            />
          </div>
        )}
        <Proposals />
        <Fold title="Parameters" sub="what the function looks up" name="parameters">
          <table class="list">
            <tbody>
              {state.value.parameters.map((p) => (
                <tr
                  key={p.name}
                  onClick={() => {
                    open(p.name);
                    screen.value = "parameters";
                  }}
                >
                  <td>
                    <b>{p.name}</b>
                  </td>
                  <td class="q">
                    {p.kind} {p.shape.join(" × ")}
                  </td>
                  <td class="q">{unitText(p.unit)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </Fold>
        <CalledFunctions />
        <Surrogates />
        <FunctionSettings />
      </section>
    </main>
  );
}

/** Alt with an arrow moves the cursor by a sample. */
function key(event: KeyboardEvent): void {
  if (!event.altKey || !["ArrowUp", "ArrowDown"].includes(event.key)) return;
  event.preventDefault();
  event.stopPropagation();
  void step(event.key === "ArrowUp" ? -1 : 1);
}

function NoFunction() {
  return (
    <div class="pad empty">
      <p>
        The function calculates what the criterion compares with the measurement. Write it as formula text, a line a
        node, or take a Simulink or an ASCET model, an FMU, an ONNX network, or a function in C or Python.
      </p>
      <p class="row">
        <button class="btn primary" onClick={() => request("new-function")}>
          New formula
        </button>
        <OpenModel text="Open a model…" kind="" />
      </p>
      <p class="q">
        Files can be dropped here: .kf, .slx, .mdl, .esdl, .app, .fmu, .onnx, .c, .py, and folders of ASCET projects.
      </p>
    </div>
  );
}

/** Load the editor when it is first shown. */
function LazyEditor({ file }: { file: string }) {
  const [Editor, setEditor] = useState<
    ((props: { file: string; choose: (node: string) => void }) => JSX.Element) | null
  >(null);
  useEffect(() => {
    void import("../../instruments/text-editor").then((module) => setEditor(() => module.TextEditor));
  }, []);
  return Editor === null ? (
    <p class="pad q">Loading the editor</p>
  ) : (
    <Editor
      file={file}
      choose={(node) => {
        chosen.value = node;
      }}
    />
  );
}
