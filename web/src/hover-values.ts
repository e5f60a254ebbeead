// What the strips show under the mouse. Of many samples at a pixel only the least and the greatest value are drawn, so
// that a value there is about that of a sample; the clicked sample alone has exact values.

import { lastUpTo } from "./drawing/strips";
import type { CriterionRow, SignalName } from "./replies";

interface DrawnLines {
  begin: number;
  raw: boolean; // each sample is drawn
  x: Float32Array;
  lines: Map<string, Float32Array>;
}

const keyOf = ({ kind, name }: SignalName): string => `${kind}:${name}`;

/** The drawn value at a position: of the sample before it, or the middle of the pixel. */
function drawnAt(data: DrawnLines, key: string, at: number): number {
  const values = data.lines.get(key);
  if (values === undefined) return NaN;
  const low = lastUpTo(data.x, at - data.begin);
  return data.raw ? values[low]! : (values[low & ~1]! + values[low | 1]!) / 2;
}

/** The value of a signal at a position; an error is the calculated value that is shown there less the measured one. */
export function valueUnder(
  data: DrawnLines | null,
  own: SignalName,
  at: number,
  criteria: readonly CriterionRow[],
): number {
  if (data === null) return NaN;
  const value = drawnAt(data, keyOf(own), at);
  if (own.kind !== "error" && own.kind !== "start error") return value;
  const node = criteria[Number(own.name)]?.node ?? "";
  const calculated = drawnAt(data, `${own.kind === "error" ? "node" : "start"}:${node}`, at);
  const measured = drawnAt(data, `target:${own.name}`, at);
  const difference = calculated - measured;
  return Number.isFinite(value) && Number.isFinite(difference) ? difference : value;
}
