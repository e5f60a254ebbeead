// What an edit makes of the selected values. Pure functions of the table.

import { counted, parseNumber, plain, shownDigit } from "../drawing/numbers";
import { rounded } from "../pending-edits";
import type { EditedTable } from "../replies";
import type { Selection } from "../store";
import { cellAt } from "./table-cells";

export type Edit =
  | { kind: "set" | "add" | "scale" | "step"; title: string; amount: number }
  | { kind: "interpolate" | "smooth" | "reference"; title: string };

/** Return the new values of `cells`; null if the edit does not apply. */
export function editCells(own: EditedTable, chosen: Selection, cells: number[], edit: Edit): number[] | null {
  const now = cells.map((cell) => own.values[cell]!);
  switch (edit.kind) {
    case "set":
      return now.map(() => edit.amount);
    case "add":
      return now.map((value) => value + edit.amount);
    case "scale":
      return now.map((value) => value * edit.amount);
    case "step":
      return now.map((value) => rounded(value + edit.amount * smallStep(own)));
    case "reference":
      return cells.map((cell) => own.reference[cell]!);
    case "interpolate":
      return pickCells(own, cells, interpolated(own, chosen));
    case "smooth":
      return pickCells(own, cells, smoothed(own, chosen));
  }
}

/** An edit that depends on the values before it only through themselves, so that it holds whatever they are by then. */
export function asOperation(own: EditedTable, edit: Edit): { kind: "add" | "scale"; amount: number } | null {
  if (edit.kind === "step") return { kind: "add", amount: rounded(edit.amount * smallStep(own)) };
  return edit.kind === "add" || edit.kind === "scale" ? { kind: edit.kind, amount: edit.amount } : null;
}

const pickCells = (own: EditedTable, cells: number[], values: number[] | null): number[] | null =>
  values === null ? null : cells.map((cell) => values[cell] ?? own.values[cell]!);

/** A thousandth of the span of the table, rounded to 1, 2 or 5, but not less than the last digit that is shown. */
export function smallStep(own: EditedTable): number {
  const span = Math.max(...own.values) - Math.min(...own.values) || Math.abs(own.values[0]!) || 1;
  const raw = span / 1000;
  const power = 10 ** Math.floor(Math.log10(raw));
  return Math.max((raw / power > 3.3 ? 5 : raw / power > 1.4 ? 2 : 1) * power, shownDigit(own.values));
}

const position = (points: number[], k: number, [from, to]: [number, number]): number =>
  to > from ? (points[k]! - points[from]!) / (points[to]! - points[from]!) : 0;

/** Bilinear between the corners of the selection; between its ends if it is one row or column. */
function interpolated(own: EditedTable, { x, y }: Selection): number[] | null {
  const xs = own.axes[0]?.points ?? [0];
  const ys = own.axes[1]?.points ?? [0];
  const values = own.values.slice();
  for (let i = x[0]; i <= x[1]; i++) {
    for (let j = y[0]; j <= y[1]; j++) {
      const [u, v] = [position(xs, i, x), position(ys, j, y)];
      const corner = (a: number, b: number) => own.values[cellAt(own, x[a]!, y[b]!)]!;
      values[cellAt(own, i, j)] = rounded(
        (1 - u) * ((1 - v) * corner(0, 0) + v * corner(0, 1)) + u * ((1 - v) * corner(1, 0) + v * corner(1, 1)),
      );
    }
  }
  return values;
}

/** Half way to the mean of the neighbours along each axis, weighted by distance. */
function smoothed(own: EditedTable, { x, y }: Selection): number[] {
  const xs = own.axes[0]?.points ?? [0];
  const ys = own.axes[1]?.points ?? [0];
  const values = own.values.slice();
  const between = (points: number[], k: number, at: (k: number) => number): number | null => {
    if (k === 0 || k === points.length - 1) return null;
    const share = (points[k]! - points[k - 1]!) / (points[k + 1]! - points[k - 1]!);
    return (1 - share) * at(k - 1) + share * at(k + 1);
  };
  for (let i = x[0]; i <= x[1]; i++) {
    for (let j = y[0]; j <= y[1]; j++) {
      const sides = [
        between(xs, i, (k) => own.values[cellAt(own, k, j)]!),
        between(ys, j, (k) => own.values[cellAt(own, i, k)]!),
      ].filter((side) => side !== null);
      if (!sides.length) continue;
      const mean = sides.reduce((sum, side) => sum + side, 0) / sides.length;
      values[cellAt(own, i, j)] = rounded((own.values[cellAt(own, i, j)]! + mean) / 2);
    }
  }
  return values;
}

/** Say which cells an edit concerns: `MapX at 3000, 40`, or `MapX, 3 x 3 points`. */
export function describeCells(own: EditedTable, { x, y, active }: Selection): string {
  const [nx, ny] = [x[1] - x[0] + 1, y[1] - y[0] + 1];
  if (nx * ny > 1) return `${own.name}, ${own.axes.length > 1 ? `${nx} \u00d7 ${ny}` : nx} points`;
  const place = own.axes.map((axis, k) => plain(axis.points[active[k]!]!, 5)).join(", ");
  return place ? `${own.name} at ${place}` : own.name;
}

/** Read what was typed: a number, `=5`, `*1,1`, `/2`, `+3`. */
export function readEdit(text: string): Edit | null {
  const operator = /^[=*/+]/.test(text) ? text[0]! : "=";
  const number = parseNumber(/^[=*/+]/.test(text) ? text.slice(1) : text);
  if (number === null) return null;
  if (operator === "*") return { kind: "scale", title: `times ${number}`, amount: number };
  if (operator === "/") return { kind: "scale", title: `divided by ${number}`, amount: 1 / number };
  if (operator === "+") return { kind: "add", title: `raised by ${number}`, amount: number };
  return { kind: "set", title: `set to ${number}`, amount: number };
}

/** What is pasted: the values that are set, where they are, and a sentence that says what was left out. */
export interface Pasted {
  cells: number[];
  values: number[];
  filled: Selection;
  remark: string;
}

/** Read what a spreadsheet has copied, from the corner of the selection on; locked values stay. */
export function readPaste(own: EditedTable, { x, y }: Selection, text: string): Pasted {
  const [nx, ny] = [own.axes[0]?.points.length ?? 1, own.axes[1]?.points.length ?? 1];
  const rows = text
    .replace(/\r/g, "")
    .replace(/\n$/, "")
    .split("\n")
    .map((row) => row.split("\t"));
  const cells: number[] = [];
  const values: number[] = [];
  const left = { "not numbers": 0, locked: 0, "beyond the table": 0 };
  const locked = new Set(own.locked);
  rows.forEach((row, j) => {
    row.forEach((each, i) => {
      const value = parseNumber(each);
      const cell = x[0] + i < nx && y[0] + j < ny ? cellAt(own, x[0] + i, y[0] + j) : -1;
      if (cell < 0) left["beyond the table"]++;
      else if (value === null) left["not numbers"]++;
      else if (locked.has(cell)) left.locked++;
      else {
        cells.push(cell);
        values.push(value);
      }
    });
  });
  const wide = Math.max(...rows.map((row) => row.length));
  const filled: Selection = {
    x: [x[0], Math.min(nx - 1, x[0] + wide - 1)],
    y: [y[0], Math.min(ny - 1, y[0] + rows.length - 1)],
    active: [x[0], y[0]],
  };
  const skipped = Object.entries(left).filter(([, number]) => number > 0);
  const told = skipped.map(([why, number]) => `${number} ${why}`).join(", ");
  const did = cells.length > 0 ? `Pasted ${counted(cells.length, "value")} into ${own.name}` : "Nothing was pasted";
  return { cells, values, filled, remark: told ? `${did}; left out: ${told}.` : `${did}.` };
}
