// Strips: plot areas one below the other over a common x axis, and positions in their traces.

import { type Area, area, type Pen, type Range, ticks } from "./canvas";

export interface Strip {
  weight: number; // share of the height
  range: Range;
  title?: string;
  scale?: "linear" | "log" | "counts";
  draw: (plot: Area) => void;
}

export interface StripsLayout {
  left: number;
  right: number;
  axis: number; // pixels below the last strip; 0 if the numbers are drawn elsewhere
  gap: number; // pixels above and below each strip
  title: string; // of the x axis
  whole?: boolean; // x counts
}

/** Draw strips over a range of x; returns their plot areas. */
export function drawStrips(
  pen: Pen,
  width: number,
  height: number,
  range: Range,
  strips: readonly Strip[],
  layout: StripsLayout,
): Area[] {
  const total = strips.reduce((sum, strip) => sum + strip.weight, 0);
  const [left, right] = [layout.left, width - layout.right];
  const xTicks = ticks(...range, Math.max(2, (right - left) / 90)).filter(
    (value) => !layout.whole || Number.isInteger(value),
  );
  let at = 0;
  return strips.map((strip, k) => {
    const tall = ((height - layout.axis) * strip.weight) / total;
    const box = { left, right, top: at + layout.gap, bottom: at + tall - layout.gap };
    at += tall;
    const last = k === strips.length - 1 && layout.axis > 0;
    const plot = area(pen, box, range, strip.range, {
      xTicks,
      unlabelled: !last,
      title: last ? layout.title : "",
      yTitle: strip.title,
      scale: strip.scale,
    });
    plot.clip(() => strip.draw(plot));
    return plot;
  });
}

/**
 * Draw the extremes of each pixel, pairs of values at the same x, as columns that touch; much faster than a stroked
 * line.
 */
export function drawColumns(
  pen: Pen,
  xs: ArrayLike<number>,
  ys: ArrayLike<number>,
  colour: string,
  width: number,
): void {
  pen.fillStyle = colour;
  const wide = Math.max(width, (xs[2] ?? xs[0]! + 1) - xs[0]!);
  let [above, below] = [NaN, NaN]; // ends of the column before
  for (let k = 0; k + 1 < ys.length; k += 2) {
    const [a, b] = [ys[k]!, ys[k + 1]!];
    let [top, bottom] = a < b ? [a, b] : [b, a];
    if (top > below) top = below;
    else if (bottom < above) bottom = above;
    [above, below] = a < b ? [a, b] : [b, a];
    const high = Math.max(width, bottom - top);
    if (high >= 0) pen.fillRect(xs[k]! - wide / 2, (top + bottom - high) / 2, wide, high); // false for NaN
  }
}

/** Return where pairs of values at the same x, such as the extremes of each pixel, lie between two ends, evenly. */
export function pairPositions(values: ArrayLike<number>, left: number, right: number): Float64Array {
  const last = values.length / 2 - 1 || 1;
  return Float64Array.from(values, (_, k) => left + ((k >> 1) / last) * (right - left));
}

/** Return the number of the last position that is not above a value, 0 if all are. */
export function lastUpTo(xs: ArrayLike<number>, value: number): number {
  let [low, high] = [0, xs.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (xs[middle]! <= value) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the numbers from the position before a range to behind the one after it; positions rise. */
export function within(xs: ArrayLike<number>, [from, to]: Range): readonly [number, number] {
  return [Math.max(0, lastUpTo(xs, from) - 1), Math.min(xs.length, lastUpTo(xs, to) + 3)];
}

/** Return the number of the position nearest to a value. */
export function nearest(xs: ArrayLike<number>, value: number): number {
  const k = lastUpTo(xs, value);
  return k + 1 < xs.length && xs[k + 1]! - value < value - xs[k]! ? k + 1 : k;
}
