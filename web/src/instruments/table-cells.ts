// The values of a table in C order: which number a value at x index i and y index j has. Pure functions.

import type { EditedTable } from "../replies";
import type { Selection } from "../store";

/** Number of columns and rows: x runs to the right, y downwards; a curve is one row. */
export const size = (own: EditedTable): [number, number] => [
  own.axes[0]?.points.length ?? 1,
  own.axes[1]?.points.length ?? 1,
];

/** Number of the value at x index i and y index j, in C order. */
export const cellAt = (own: EditedTable, i: number, j: number): number => i * size(own)[1] + j;

export function cellsOf(own: EditedTable, chosen: Selection): number[] {
  const cells: number[] = [];
  for (let i = chosen.x[0]; i <= chosen.x[1]; i++)
    for (let j = chosen.y[0]; j <= chosen.y[1]; j++) cells.push(cellAt(own, i, j));
  return cells;
}
