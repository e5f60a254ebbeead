// The table of a parameter: cells coloured by value, a rectangle selected by mouse or keys, edited as in a spreadsheet.

import { signal, useSignal } from "@preact/signals";
import { Component } from "preact";
import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { copyAs } from "../copying";
import { extent } from "../drawing/canvas";
import { cellColours } from "../drawing/colours";
import { counted, fixed, significant, tableDecimals, tableFormat } from "../drawing/numbers";
import type { EditedTable } from "../replies";
import { changeValues, message, type Selection, selection, setValues, theme } from "../store";
import { toggleLocks, togglePins } from "./cell-marks";
import { cellTints, coverOf, coverTitle } from "./coverage";
import { showEvidence } from "./evidence";
import { cellAt, cellsOf, size } from "./table-cells";
import { asOperation, describeCells, type Edit, editCells, readEdit, readPaste } from "./table-edits";

export type Mode = "value" | "difference" | "percent";

export interface Shown {
  mode: Mode;
  empty: boolean;
  deviation: boolean;
  ghost: boolean;
}

/** What the table, the surface and the slices show beside the values. */
export const shownMarks = signal<Shown>({ mode: "value", empty: true, deviation: true, ghost: true });

/** Keys that change what is shown. */
const SHOWING: Record<string, (now: Shown) => Partial<Shown>> = {
  d: ({ mode }) => ({ mode: mode === "difference" ? "value" : "difference" }),
  g: ({ ghost }) => ({ ghost: !ghost }),
  h: ({ empty }) => ({ empty: !empty }),
};

function shownValues(own: EditedTable, mode: Mode): number[] {
  if (mode === "value") return own.values;
  return own.values.map((value, k) => {
    const difference = value - own.reference[k]!;
    return mode === "difference" ? difference : difference === 0 ? 0 : (difference / Math.abs(own.reference[k]!)) * 100;
  });
}

/**
 * Length of the bar that shows a standard deviation, 0 to 1, logarithmic from 0.1 % of the span of the values to all.
 */
function bars(own: EditedTable): (number | null)[] {
  if (own.deviation === null) return own.values.map(() => null);
  const [low, high] = extent(own.values);
  const span = high - low || Math.abs(high) || 1;
  return own.deviation.map((value) =>
    value === null ? 1 : value <= 0 ? 0 : Math.max(0, Math.min(1, 1 + Math.log10(value / span) / 3)),
  );
}

/** Edit the selected values that are not locked. */
export function applyEdit(own: EditedTable, edit: Edit): void {
  const cells = cellsOf(own, selection.value).filter((cell) => !own.locked.includes(cell));
  if (cells.length === 0) {
    message.value = `Nothing was changed: the selected values of ${own.name} are locked.`;
    return;
  }
  const title = `${describeCells(own, selection.value)}: ${edit.title}`;
  const operation = asOperation(own, edit);
  const next = operation === null ? editCells(own, selection.value, cells, edit) : null;
  if (operation !== null) changeValues(cells, operation.kind, operation.amount, title);
  else if (next !== null) setValues(cells, next, title);
}

export function MapTable({ own }: { own: EditedTable }) {
  const shown = shownMarks.value;
  const [nx, ny] = size(own);
  const chosen = selection.value;
  const locked = new Set(own.locked);
  const typed = useSignal<string | null>(null);
  const body = useRef<HTMLTableElement>(null);
  const looks = cellLooks(own, shown, chosen, locked, typed.value);
  const xText = labels(own.axes[0]?.points ?? [0]);
  const yText = labels(own.axes[1]?.points ?? [0]);

  useEffect(() => {
    body.current?.querySelector<HTMLElement>(".active")?.scrollIntoView({ block: "nearest", inline: "nearest" });
  }, [chosen]);

  const pick = (event: MouseEvent) => {
    const cell = (event.target as HTMLElement).closest<HTMLElement>("td[data-cell]");
    if (cell === null) return;
    const [i, j] = cell.dataset.cell!.split(",").map(Number) as [number, number];
    cell.title = cellTitle(own, cellAt(own, i, j)); // written when it is looked at: there are many cells
    if (event.buttons !== 1) return;
    if (event.type === "mousedown" && !event.shiftKey) {
      selection.value = { x: [i, i], y: [j, j], active: [i, j] };
      typed.value = null;
    } else {
      const [a, b] = selection.value.active;
      selection.value = { x: [Math.min(a, i), Math.max(a, i)], y: [Math.min(b, j), Math.max(b, j)], active: [a, b] };
    }
  };

  useLayoutEffect(() => copyAs(body.current!, () => exactRows(own)), [own]);

  const apply = (edit: Edit) => applyEdit(own, edit);

  const key = (event: KeyboardEvent) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const moves: Record<string, [number, number]> = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, -1],
      ArrowDown: [0, 1],
      Home: [-nx, 0],
      End: [nx, 0],
      PageUp: [0, -ny],
      PageDown: [0, ny],
    };
    const move = moves[event.key];
    const text = typed.value;
    if (move !== undefined) {
      step(own, move, event.shiftKey);
      typed.value = null;
    } else if (event.key === "Enter" && text !== null) {
      const edit = readEdit(text);
      typed.value = null;
      if (edit !== null) apply(edit);
    } else if (event.key === "Escape") typed.value = null;
    else if (event.key === "Backspace" && text !== null) typed.value = text.slice(0, -1) || null;
    else if (text === null && (event.key === "+" || event.key === "-"))
      apply({
        kind: "step",
        title: event.key === "+" ? "raised" : "lowered",
        amount: (event.key === "+" ? 1 : -1) * (event.shiftKey ? 10 : 1),
      });
    else if (text === null && event.key === "i") apply({ kind: "interpolate", title: "interpolated" });
    else if (text === null && event.key === "s") apply({ kind: "smooth", title: "smoothed" });
    else if (text === null && event.key === "Delete") apply({ kind: "reference", title: "set to the reference" });
    else if (text === null && event.key === "l") toggleLocks(own);
    else if (text === null && event.key === "p") togglePins(own);
    else if (text === null && event.key === "e") showEvidence();
    else if (text === null && SHOWING[event.key]) shownMarks.value = { ...shown, ...SHOWING[event.key]!(shown) };
    else if (/^[\d.,=*/+\-eE]$/.test(event.key)) typed.value = (text ?? "") + event.key;
    else return;
    event.preventDefault();
    event.stopPropagation();
  };

  return (
    <table
      class={`grid ${shown.deviation && own.deviation ? "spread" : ""}`}
      ref={body}
      tabIndex={0}
      role="grid"
      aria-label={`Values of ${own.name}`}
      onMouseDown={pick}
      onMouseOver={pick}
      onKeyDown={key}
      onCopy={(event) => copy(event, own)}
      onPaste={(event) => paste(event, own)}
    >
      <colgroup>
        <col class="c0" />
        {xText.map(() => (
          <col />
        ))}
      </colgroup>
      <tbody>
        <tr>
          <th class="corner" title={cornerTitle(own)}>
            {corner(own)}
          </th>
          {xText.map((text, i) => (
            <th class={i === chosen.active[0] ? "at" : ""}>{text}</th>
          ))}
        </tr>
        {yText.map((text, j) => (
          <Row
            name={own.axes.length > 1 ? text : own.unit || "value"}
            at={j === chosen.active[1]}
            j={j}
            looks={xText.map((_, i) => looks(i, j))}
          />
        ))}
      </tbody>
    </table>
  );
}

/** The table with its axes, all digits of its numbers. */
function exactRows(own: EditedTable): string[][] {
  const [nx, ny] = size(own);
  const xs = own.axes[0]?.points ?? [];
  const ys = own.axes[1]?.points;
  const rows = Array.from({ length: ny }, (_, j) => [
    String(ys?.[j] ?? own.name),
    ...Array.from({ length: nx }, (_, i) => String(own.values[cellAt(own, i, j)])),
  ]);
  return xs.length ? [[corner(own), ...xs.map(String)], ...rows] : rows;
}

interface Look {
  text: string;
  kind: string;
  colour: string;
  bar: string;
  note: string;
}
interface RowProps {
  name: string;
  at: boolean;
  j: number;
  looks: Look[];
}

/** A row of cells, rendered only if one of them looks different: an edit seldom changes more than a row. */
class Row extends Component<RowProps> {
  override shouldComponentUpdate(next: RowProps): boolean {
    const { name, at, j, looks } = this.props;
    return (
      next.name !== name ||
      next.at !== at ||
      next.j !== j ||
      next.looks.length !== looks.length ||
      !next.looks.every((look, i) => sameLook(look, looks[i]!))
    );
  }

  render({ name, at, j, looks }: RowProps) {
    return (
      <tr>
        <th class={at ? "at" : ""}>{name}</th>
        {looks.map((look, i) => (
          <td data-cell={`${i},${j}`} class={look.kind} style={{ "--c": look.colour, "--s": look.bar }}>
            {look.note ? <s class="cv" data-note={look.note} /> : null}
            {look.text}
          </td>
        ))}
      </tr>
    );
  }
}

/** Return a function that says how a cell looks: what is the same for all cells is computed once. */
function cellLooks(
  own: EditedTable,
  shown: Shown,
  chosen: Selection,
  locked: Set<number>,
  typed: string | null,
): (i: number, j: number) => Look {
  const values = shownValues(own, shown.mode);
  const format = tableFormat(values, {
    signed: shown.mode !== "value",
    decimals: shown.mode === "percent" ? 1 : undefined,
  });
  void theme.value;
  const cover = coverOf(own);
  const colours =
    cover === null ? cellColours(values, shown.mode === "value" ? "height" : "difference") : cellTints(cover);
  const deviations = shown.deviation ? bars(own) : null;
  return (i, j) => {
    const at = cellAt(own, i, j);
    const active = i === chosen.active[0] && j === chosen.active[1];
    return {
      text: active && typed !== null ? typed : format(values[at]!),
      kind: cellClass(own, shown, chosen, locked, i, j, at),
      colour: colours[at] ?? "transparent",
      bar: deviations === null ? "0" : (deviations[at] ?? 0).toFixed(2),
      note: cover?.notes[at] ?? "",
    };
  };
}

const sameLook = (a: Look, b: Look): boolean =>
  a.text === b.text && a.kind === b.kind && a.colour === b.colour && a.bar === b.bar && a.note === b.note;

function labels(points: number[]): string[] {
  const decimals = tableDecimals(points.map((p) => Number(p.toPrecision(5))));
  return points.map((point) => fixed(point, decimals));
}

function corner(own: EditedTable): string {
  const [x, y] = own.axes;
  if (!y) return x?.unit ?? "";
  return `${y.unit || y.input} \\ ${x?.unit || x?.input}`;
}

const cornerTitle = (own: EditedTable): string =>
  own.axes[1] ? `${own.axes[1].input} over ${own.axes[0]?.input}` : (own.axes[0]?.input ?? "");

function cellClass(
  own: EditedTable,
  shown: Shown,
  chosen: Selection,
  locked: Set<number>,
  i: number,
  j: number,
  at: number,
): string {
  const inside = i >= chosen.x[0] && i <= chosen.x[1] && j >= chosen.y[0] && j <= chosen.y[1];
  const single = chosen.x[0] === chosen.x[1] && chosen.y[0] === chosen.y[1];
  return [
    inside && !single ? "s" : "",
    inside && !single && i === chosen.x[0] ? "sl" : "",
    inside && !single && i === chosen.x[1] ? "sr" : "",
    inside && !single && j === chosen.y[0] ? "st" : "",
    inside && !single && j === chosen.y[1] ? "sb" : "",
    i === chosen.active[0] && j === chosen.active[1] ? `active ${own.samples?.[at] ? "ev" : ""}` : "",
    shown.empty && own.samples?.[at] === 0 ? "nd" : "",
    locked.has(at) ? "lock" : "",
    own.pinned.includes(at) ? "pinned" : "",
    own.waiting.includes(at) ? "waits" : "",
    own.values[at] !== own.reference[at] ? "changed" : "",
  ]
    .filter(Boolean)
    .join(" ");
}

/** What is known of a value, line by line. */
export function cellTitle(own: EditedTable, at: number): string {
  const deviation = own.deviation?.[at];
  return [
    `${significant(own.values[at]!, 6)} ${own.unit}`,
    own.values[at] === own.reference[at] ? "" : `${own.referenceTitle} ${significant(own.reference[at]!, 6)}`,
    deviation === undefined
      ? ""
      : deviation === null
        ? "undetermined"
        : `standard deviation ${significant(deviation, 3)}`,
    own.samples === null ? "" : `${own.samples[at]} samples`,
    own.locked.includes(at) ? "locked" : "",
    own.pinned.includes(at) ? "pinned" : "",
    coverTitle(own, at),
    own.waiting.includes(at) ? "an edit waits for the end of the run" : "",
  ]
    .filter(Boolean)
    .join("\n");
}

function step(own: EditedTable, [dx, dy]: [number, number], extend: boolean): void {
  const [nx, ny] = size(own);
  const { x, y, active } = selection.value;
  const clamp = (value: number, count: number) => Math.max(0, Math.min(count - 1, value));
  if (!extend) {
    const [i, j] = [clamp(active[0] + dx, nx), clamp(active[1] + dy, ny)];
    selection.value = { x: [i, i], y: [j, j], active: [i, j] };
    return;
  }
  const far = (range: [number, number], at: number, by: number, count: number): [number, number] => {
    const moved = clamp((range[0] === at ? range[1] : range[0]) + by, count);
    return [Math.min(at, moved), Math.max(at, moved)];
  };
  selection.value = { x: far(x, active[0], dx, nx), y: far(y, active[1], dy, ny), active };
}

function copy(event: ClipboardEvent, own: EditedTable): void {
  const { x, y } = selection.value;
  const rows: string[] = [];
  for (let j = y[0]; j <= y[1]; j++) {
    const row: string[] = [];
    for (let i = x[0]; i <= x[1]; i++) row.push(String(own.values[cellAt(own, i, j)]));
    rows.push(row.join("\t"));
  }
  event.clipboardData?.setData("text/plain", rows.join("\n"));
  event.preventDefault();
}

function paste(event: ClipboardEvent, own: EditedTable): void {
  event.preventDefault();
  const pasted = readPaste(own, selection.value, event.clipboardData?.getData("text/plain") ?? "");
  if (pasted.cells.length > 0) {
    setValues(pasted.cells, pasted.values, `Pasted ${counted(pasted.cells.length, "value")} into ${own.name}`);
    selection.value = pasted.filled;
  }
  message.value = pasted.remark;
}
