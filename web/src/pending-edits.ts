// Edits of values that the server has not answered yet. The page shows them at once, over what the server says; one is
// sent at a time, and those that wait meanwhile are joined, so that steps add up and only the last move of a drag counts.
// A command that is to find them, such as Undo or Save, has all of them sent before it.

import type { ValueEdit } from "./replies";

/** The values of a table after an edit; the server rounds in the same way. */
export function afterEdit(values: readonly number[], edit: ValueEdit): number[] {
  const next = values.slice();
  edit.cells.forEach((cell, k) => {
    if (edit.kind === "add") next[cell] = rounded(next[cell]! + (edit.amount ?? 0));
    else if (edit.kind === "scale") next[cell] = rounded(next[cell]! * (edit.amount ?? 1));
    else next[cell] = edit.values![k]!;
  });
  return next;
}

/** A result of arithmetic without the digits of rounding: 0.1 added ten times is 1. */
export const rounded = (value: number): number => Number(value.toPrecision(12));

const sameCells = (a: ValueEdit, b: ValueEdit): boolean =>
  a.cells.length === b.cells.length && a.cells.every((cell, k) => cell === b.cells[k]);

/** One edit in place of two that follow each other; null if both stay. */
export function joined(first: ValueEdit, then: ValueEdit): ValueEdit | null {
  if (first.name !== then.name) return null;
  if (then.drag && first.drag === then.drag && sameCells(first, then)) return then;
  if (first.kind !== "add" || then.kind !== "add" || first.drag || then.drag || !sameCells(first, then)) return null;
  return { ...then, amount: rounded((first.amount ?? 0) + (then.amount ?? 0)) };
}

export class PendingEdits {
  private waiting: ValueEdit[] = [];
  private sent: ValueEdit[] = []; // answers come in the order of the questions

  get isEmpty(): boolean {
    return this.sent.length === 0 && this.waiting.length === 0;
  }

  add(edit: ValueEdit): void {
    const last = this.waiting.at(-1);
    const both = last === undefined ? null : joined(last, edit);
    if (both === null) this.waiting.push(edit);
    else this.waiting[this.waiting.length - 1] = both;
  }

  /** The edit to send now; null if none waits, or one has been sent and not been answered. */
  take(): ValueEdit | null {
    return this.sent.length > 0 ? null : (this.takeAll(1)[0] ?? null);
  }

  /** The edits that wait, to be sent now one after the other. */
  takeAll(limit = this.waiting.length): ValueEdit[] {
    const taken = this.waiting.splice(0, limit);
    this.sent.push(...taken);
    return taken;
  }

  /** The edit that was sent first is answered: what the server says from now on has it. */
  answered(): void {
    this.sent.shift();
  }

  clear(): void {
    this.waiting = [];
    this.sent = [];
  }

  /** The values of a table as they will be. */
  over(name: string, values: readonly number[]): number[] {
    return [...this.sent, ...this.waiting]
      .filter((edit) => edit.name === name)
      .reduce<number[]>(afterEdit, values.slice());
  }
}
