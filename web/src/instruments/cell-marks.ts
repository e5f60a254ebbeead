// Locks, pins and fits of the selected values of a table, each for the project file or as a run of its own.

import { counted } from "../drawing/numbers";
import type { EditedTable } from "../replies";
import { isRunning, message, request, selection, state } from "../store";
import { cellAt, cellsOf } from "./table-cells";
import { describeCells } from "./table-edits";

/** True if all selected values are among some of the table. */
export function areAll(own: EditedTable, marked: readonly number[]): boolean {
  const known = new Set(marked);
  return cellsOf(own, selection.value).every((cell) => known.has(cell));
}

/** Lock the selected values, or unlock them if all are locked. */
export function toggleLocks(own: EditedTable): void {
  const on = !areAll(own, own.locked);
  void mark("lock-values", own, on, on ? "locked" : "unlocked");
}

/** Pin the selected values to what they are, or remove their pins if all are pinned. */
export function togglePins(own: EditedTable): void {
  const on = !areAll(own, own.pinned);
  void mark("pin-values", own, on, on ? "pinned" : "not pinned");
}

async function mark(question: "lock-values" | "pin-values", own: EditedTable, on: boolean, outcome: string) {
  const title = `${describeCells(own, selection.value)}: ${outcome}`;
  const cells = cellsOf(own, selection.value);
  if ((await request(question, { name: own.name, cells, on, title })) !== null) message.value = title;
}

/** Why no value of the selection can be fitted on its own; empty if it can. */
export function whyUnfit(own: EditedTable): string {
  const free = state.value.parameters.find((each) => each.name === own.name)?.free ?? false;
  if (!free) return `${own.name} is fixed`;
  if (isRunning(state.value.job)) return "a run is in progress";
  return areAll(own, own.locked) ? "locked" : "";
}

/** Fit the selected values, or the active one alone; all others are held. */
export function fitOnly(own: EditedTable, single = false): void {
  const [i, j] = selection.value.active;
  const part = single
    ? { x: [i, i] as [number, number], y: [j, j] as [number, number], active: selection.value.active }
    : selection.value;
  const cells = single ? [cellAt(own, i, j)] : cellsOf(own, part);
  const title = describeCells(own, part);
  message.value = `Fitting ${counted(cells.length, "value")}: ${title}`;
  void request("run", { only: { name: own.name, cells, title } });
}
