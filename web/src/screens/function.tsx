// The function: formula text with its errors at the character, and the value of each node at the cursor of the plots.

import { signal } from "@preact/signals";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { ErrorSplit, placeText, split } from "../instruments/error-split";
import { Proposals } from "../instruments/proposals";
import { settings } from "../settings";
import { open, screen, state } from "../store";

const shownText = signal<"function" | "project">("function");
export function Function() {
  const { file } = settings.value;
  const own = shownText.value === "function" ? file : "";
  const errors = state.value.findings.filter((f) => f.screen === "function");
  return (
    <>
      <main class="function">
        <section class="pane text">
          <div class="head">
            <h2>{own || "Project file"}</h2><span class="sub">{own ? "a line a node: name[unit] = expression" : "every setting, with its line and message"}</span>
            <span class="right"><span class="seg tight" role="group" aria-label="Text">
              <button aria-pressed={own !== ""} disabled={!file} onClick={() => { shownText.value = "function"; }}>Function</button>
              <button aria-pressed={own === ""} data-text="project" onClick={() => { shownText.value = "project"; }}>Project file</button>
            </span></span>
          </div>
          <LazyEditor key={own} file={own} />
          {errors.length > 0 && <div class="cks">{errors.map((f) => <div class={`ck ${f.severity === "remark" ? "i" : "w"}`}><Icon name={f.severity === "remark" ? "find" : "warning"} /><span class="grow">{f.text}</span></div>)}</div>}
        </section>
        <section class="pane nodes">
          <div class="head"><h2>At the cursor</h2><span class="sub">{split.value === null ? "" : placeText(split.value)}</span></div>
          <ErrorSplit nodes />
          <Proposals />
          <div class="head mid"><h2>Parameters</h2><span class="sub">what the function looks up</span></div>
          <table class="list"><tbody>{state.value.parameters.map((p) => <tr onClick={() => { open(p.name); screen.value = "parameters"; }}><td><b>{p.name}</b></td><td class="q">{p.kind} {p.shape.join(" × ")}</td><td class="q">{p.unit}</td></tr>)}</tbody></table>
        </section>
      </main>
      <Footer><Key keys={["Ctrl", "Z"]} text="undo" /><Key keys={["Ctrl", "S"]} text="save" /></Footer>
    </>
  );
}

/** Load the editor when it is first shown. */
function LazyEditor({ file }: { file: string }) {
  const [Editor, setEditor] = useState<((props: { file: string }) => JSX.Element) | null>(null);
  useEffect(() => { void import("../instruments/text-editor").then((module) => setEditor(() => module.TextEditor)); }, []);
  return Editor === null ? <p class="pad q">Loading the editor</p> : <Editor file={file} />;
}
