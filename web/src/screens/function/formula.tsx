// Formula text as the function: the editor, its messages, and what the error at the cursor is made of.

import { signal } from "@preact/signals";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { ErrorSplit, placeText, split } from "../../instruments/error-split";
import { Proposals } from "../../instruments/proposals";
import { settings } from "../../settings";
import { open, request, screen, state } from "../../store";
import { Fold } from "./fold";
import { FunctionChoice, OpenModel } from "./function-choice";
import { FunctionSettings } from "./function-settings";
import { Messages } from "./messages";
import { Surrogates } from "./surrogates";

const text = signal<"function" | "project">("function");

export function FormulaText() {
  const { file } = settings.value;
  const own = text.value === "function" ? file : "";
  return (
    <main class="function formula">
      <section class="pane text">
        <div class="head">
          {own ? <FunctionChoice /> : <h2>Project file</h2>}
          <span class="right"><span class="seg tight" role="group" aria-label="Text">
            <button aria-pressed={text.value === "function"} onClick={() => { text.value = "function"; }}>Function</button>
            <button aria-pressed={text.value === "project"} data-text="project" onClick={() => { text.value = "project"; }}>Project file</button>
          </span></span>
        </div>
        {own !== "" && <div class="ln hd"><i /><code>node [unit] = expression</code><span class="u">unit</span><span class="num">start</span><span class="num">now</span></div>}
        {text.value === "function" && file === "" ? <NoFunction /> : <LazyEditor key={own} file={own} />}
        <Messages />
      </section>
      <section class="pane nodes">
        <div class="head"><h2>At the cursor</h2><span class="sub">{split.value === null ? "" : placeText(split.value)}</span></div>
        <ErrorSplit nodes />
        <Proposals />
        <Fold title="Parameters" sub="what the function looks up" name="parameters" open>
          <table class="list"><tbody>{state.value.parameters.map((p) => <tr key={p.name} onClick={() => { open(p.name); screen.value = "parameters"; }}><td><b>{p.name}</b></td><td class="q">{p.kind} {p.shape.join(" × ")}</td><td class="q">{p.unit}</td></tr>)}</tbody></table>
        </Fold>
        <Surrogates />
        <FunctionSettings />
      </section>
    </main>
  );
}

function NoFunction() {
  return (
    <div class="pad empty">
      <p>The function calculates what the criterion compares with the measurement. Write it as formula text, a line a node, or take a Simulink model.</p>
      <p class="row"><button class="btn primary" onClick={() => request("new-function")}>New formula</button><OpenModel text="Open Simulink model…" kind="" /></p>
      <p class="q">Files can be dropped here: .kf, .slx, .mdl.</p>
    </div>
  );
}

/** Load the editor when it is first shown. */
function LazyEditor({ file }: { file: string }) {
  const [Editor, setEditor] = useState<((props: { file: string }) => JSX.Element) | null>(null);
  useEffect(() => { void import("../../instruments/text-editor").then((module) => setEditor(() => module.TextEditor)); }, []);
  return Editor === null ? <p class="pad q">Loading the editor</p> : <Editor file={file} />;
}
