// The formula text of an imported model: each line with the value of its node at the cursor, lines of the chosen block lit.

import { signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Segment } from "../../fields";
import { shown, split, useSplit } from "../../instruments/error-split";
import { reveal } from "./block-tree";
import { chosen, diagram, type Line } from "./source";

const filter = signal("all");

export function FormulaLines() {
  useSplit();
  const list = useRef<HTMLDivElement>(null);
  const own = diagram.value;
  const values = new Map((split.value?.nodes ?? []).map((node) => [node.name, node]));
  const lines = (own?.lines ?? []).map((line, k) => ({ ...line, number: k + 1, lit: isOf(line, chosen.value) }));
  const drawn = filter.value === "this block" ? lines.filter((line) => line.lit) : lines;
  useEffect(() => { list.current?.querySelector(".lit-line")?.scrollIntoView({ block: "nearest" }); }, [chosen.value, own]);
  return (
    <>
      <div class="head"><h2>Formula text</h2><span class="sub">what will be calculated</span><span class="right"><Segment label="Lines" options={["all", "this block"]} chosen={filter.value} choose={(next) => { filter.value = next; }} /></span></div>
      <div class="ln hd"><i /><code>node [unit] = expression</code><span class="num">start</span><span class="num">now</span></div>
      <div class="code mono" ref={list} role="list" aria-label="Formula text">
        {drawn.map((line) => <LineRow key={line.number} line={line} value={defines(line) ? values.get(line.node) : undefined} />)}
        {lines.length === 0 && <p class="pad q">The formula text is shown once nothing stops the import.</p>}
        {lines.length > 0 && drawn.length === 0 && <p class="pad q">No line comes from this block alone: it is part of other lines, or only passes a signal on.</p>}
      </div>
    </>
  );
}

const isOf = (line: Line, path: string): boolean => path !== "" && line.path !== "" && (line.path === path || line.path.startsWith(`${path}/`));

/** True if the line is that of the node itself, not of an auxiliary node `_1`. */
const defines = (line: Line): boolean => line.node !== "" && !/^_\d+ =/.test(line.text);

function LineRow({ line, value }: { line: Line & { number: number; lit: boolean }; value: { start: number | null; now: number | null; unit: string } | undefined }) {
  return (
    <div class={`ln ${line.lit ? "lit-line" : ""}`} role="listitem" data-line={line.number} title={line.path || undefined} onClick={() => { if (line.path) reveal(line.path); }}>
      <i>{line.number}</i><code><Formula text={line.text} /></code><span class="num q">{value && shown(value.start)}</span><span class="num ink">{value && shown(value.now)}</span>
    </div>
  );
}

const TOKEN = /(#.*$)|(%(?:[^%]|%%)*%)|((?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?)|(\b(?:input|output|scalar|curve|map|cube|rbf|step)\b(?= [\w%]))|([A-Za-z_]\w*)(?=\()|([A-Za-z_][\w.]*)/g;

/** Formula text with its tokens coloured: comments, numbers, tables and functions. */
export function Formula({ text }: { text: string }) {
  const tables = new Set((diagram.value?.parameters ?? []).map((each) => each.name));
  const parts: preact.ComponentChildren[] = [];
  let end = 0;
  for (const match of text.matchAll(TOKEN)) {
    parts.push(text.slice(end, match.index));
    const [whole, comment, quoted, number, keyword, call, name] = match;
    const kind = comment ? "kc" : number ? "kn" : keyword ? "kf" : tables.has((quoted ?? call ?? name ?? "").replaceAll("%", "")) ? "kp" : call ? "kf" : "";
    parts.push(kind ? <span class={kind}>{whole}</span> : whole);
    end = match.index + whole.length;
  }
  return <>{parts}{text.slice(end)}</>;
}
