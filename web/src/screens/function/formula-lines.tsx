// The formula text of an imported model: each line with the value of its node at the cursor, lines of the chosen block
// or variable lit.

import { useEffect, useRef } from "preact/hooks";
import { numberText } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { split, useSplit } from "../../instruments/error-split";
import type { FormulaLine } from "../../replies";
import { scoped } from "../../scope";
import { chosen } from "./source";

const filter = scoped("all");

interface Props {
  lines: FormulaLine[] | undefined;
  tables: string[];
  part?: string; // what a line comes from: this block, this variable
  alone?: string; // why a part has no line
  lit?: (line: FormulaLine) => boolean;
  go?: (path: string) => void; // shows where a line comes from
}

export function FormulaLines({ lines: own, tables, part = "", alone, lit = () => false, go = () => {} }: Props) {
  useSplit();
  const list = useRef<HTMLDivElement>(null);
  const values = new Map((split.value?.nodes ?? []).map((node) => [node.name, node]));
  const lines = (own ?? []).map((line, k) => ({ ...line, number: k + 1, lit: lit(line) }));
  const drawn = part && filter.value !== "all" ? lines.filter((line) => line.lit) : lines;
  useEffect(() => {
    list.current?.querySelector(".lit-line")?.scrollIntoView({ block: "nearest" });
  }, [chosen.value, own]);
  return (
    <>
      <div class="head">
        <h2>Formula text</h2>
        <span class="sub">what will be calculated</span>
        {part && (
          <span class="right">
            <Segment
              label="Lines"
              options={["all", part]}
              chosen={filter.value === "all" ? "all" : part}
              choose={(next) => {
                filter.value = next;
              }}
            />
          </span>
        )}
      </div>
      <div class="ln hd">
        <i />
        <code>node [unit] = expression</code>
        <span class="num">start</span>
        <span class="num">now</span>
      </div>
      <div class="code mono" ref={list} role="list" aria-label="Formula text">
        {drawn.map((line) => (
          <LineRow
            key={line.number}
            line={line}
            tables={tables}
            go={go}
            value={defines(line) ? values.get(line.node) : undefined}
          />
        ))}
        {lines.length === 0 && <p class="pad q">The formula text is shown once nothing stops the import.</p>}
        {lines.length > 0 && drawn.length === 0 && <p class="pad q">{alone}</p>}
      </div>
    </>
  );
}

/** True if the line is that of the node itself, not of an auxiliary node `_1`. */
const defines = (line: FormulaLine): boolean => line.node !== "" && !/^_\d+ =/.test(line.text);

function LineRow({
  line,
  tables,
  go,
  value,
}: {
  line: FormulaLine & { number: number; lit: boolean };
  tables: string[];
  go: (path: string) => void;
  value: { start: number | null; now: number | null; unit: string } | undefined;
}) {
  return (
    <div
      class={`ln ${line.lit ? "lit-line" : ""}`}
      role="listitem"
      data-line={line.number}
      title={line.path || undefined}
      onClick={() => {
        if (line.path) go(line.path);
      }}
    >
      <i>{line.number}</i>
      <code>
        <Formula text={line.text} tables={tables} />
      </code>
      <span class="num q">{value && numberText(value.start)}</span>
      <span class="num ink">{value && numberText(value.now)}</span>
    </div>
  );
}

const TOKEN =
  /(#.*$)|(%(?:[^%]|%%)*%)|((?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?)|(\b(?:input|output|scalar|curve|map|cube|rbf|step)\b(?= [\w%]))|([A-Za-z_]\w*)(?=\()|([A-Za-z_][\w.]*)/g;

/** Formula text with its tokens coloured: comments, numbers, tables and functions. */
function Formula({ text, tables }: { text: string; tables: string[] }) {
  const parts: preact.ComponentChildren[] = [];
  let end = 0;
  for (const match of text.matchAll(TOKEN)) {
    parts.push(text.slice(end, match.index));
    const [whole, comment, quoted, number, keyword, call, name] = match;
    const kind = comment
      ? "kc"
      : number
        ? "kn"
        : keyword
          ? "kf"
          : tables.includes((quoted ?? call ?? name ?? "").replaceAll("%", ""))
            ? "kp"
            : call
              ? "kf"
              : "";
    parts.push(kind ? <span class={kind}>{whole}</span> : whole);
    end = match.index + whole.length;
  }
  return (
    <>
      {parts}
      {text.slice(end)}
    </>
  );
}
