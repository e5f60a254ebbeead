// The function: formula text with its errors at the character, and the value of each node at the cursor of the plots.

import { effect, signal } from "@preact/signals";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { newest } from "../connection";
import { MISSING, significant, signed } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { Proposals } from "../instruments/proposals";
import { cursor, datasetNumber } from "../plots";
import { settings } from "../settings";
import { open, request, screen, settled, state } from "../store";
import { FunctionSettings } from "./function/settings";

interface NodeValue { name: string; now: number | null; start: number | null }
const values = signal<NodeValue[]>([]);
const shownText = signal<"function" | "project">("function");
const place = signal<{ sample: number; position: number }>({ sample: 0, position: 0 });

const loadValues = newest(async (position: number) => {
  const reply = await request("sample", { dataset: datasetNumber.value, position });
  if (reply === null) return;
  values.value = reply.head.nodes as NodeValue[];
  place.value = { sample: reply.head.sample as number, position: reply.head.position as number };
});

effect(() => {
  const dataset = settled.value.datasets[datasetNumber.value];
  if (screen.value === "function" && dataset !== undefined) loadValues(cursor.value ?? (dataset.begin + dataset.end) / 2);
});

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
          <div class="head"><h2>Nodes</h2><span class="sub">{state.value.datasets[datasetNumber.value]?.name} at {significant(place.value.position, 6)}</span></div>
          <table class="list">
            <thead><tr><th>node</th><th>unit</th><th class="num">start</th><th class="num">now</th><th class="num">change</th></tr></thead>
            <tbody>{values.value.map((node) => <tr><td><b>{node.name}</b></td><td class="q">{state.value.nodes.find((n) => n.name === node.name)?.unit}</td><td class="num q">{number(node.start)}</td><td class="num ink">{number(node.now)}</td><td class="num">{node.now === null || node.start === null || node.now === node.start ? "" : signed(node.now - node.start)}</td></tr>)}</tbody>
          </table>
          <Proposals />
          <FunctionSettings />
          <div class="head mid"><h2>Parameters</h2><span class="sub">what the function looks up</span></div>
          <table class="list"><tbody>{state.value.parameters.map((p) => <tr onClick={() => { open(p.name); screen.value = "parameters"; }}><td><b>{p.name}</b></td><td class="q">{p.kind} {p.shape.join(" × ")}</td><td class="q">{p.unit}</td></tr>)}</tbody></table>
        </section>
      </main>
      <Footer><Key keys={["Ctrl", "Z"]} text="undo" /><Key keys={["Ctrl", "S"]} text="save" /></Footer>
    </>
  );
}

const number = (value: number | null): string => (value === null ? MISSING : significant(value));

/** Load the editor when it is first shown. */
function LazyEditor({ file }: { file: string }) {
  const [Editor, setEditor] = useState<((props: { file: string }) => JSX.Element) | null>(null);
  useEffect(() => { void import("../instruments/text-editor").then((module) => setEditor(() => module.TextEditor)); }, []);
  return Editor === null ? <p class="pad q">Loading the editor</p> : <Editor file={file} />;
}
