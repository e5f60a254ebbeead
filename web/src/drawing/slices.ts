// Curves over one axis, and slices of maps: values, reference, standard deviation, points without data.

import { type Area, area, type Box, extent, line, type Pen, type Range, widened } from "./canvas";
import { token } from "./colours";
import { band, dots, hatch, ring } from "./marks";

export interface SliceData {
  points: readonly number[];
  now: readonly number[];
  before: readonly number[] | null;
  deviation: readonly (number | null)[] | null;
  empty: readonly boolean[] | null; // points without data
  active: number;
  title: string;
  places?: { x: ArrayLike<number>; value: ArrayLike<number> } | null; // dots
}

/** Draw a slice through the active point; `range` keeps the axis while a value is dragged. */
export function drawSlice(pen: Pen, width: number, height: number, data: SliceData, range: Range | null): Area {
  const { points, now, before, deviation, empty, active } = data;
  const box = { left: 44, right: width - 14, top: 10, bottom: height - 36 };
  const plot = area(pen, box, widened(extent(points), 0), range ?? widened(extent(now, before ?? []), 0.1), {
    title: data.title,
  });
  const xs = points.map(plot.x);
  const ys = now.map(plot.y);
  plot.clip(() => {
    if (empty) hatchPoints(pen, box, xs, empty);
    if (deviation) {
      const side = (sign: number) => now.map((value, k) => plot.y(value + sign * 2 * (deviation[k] ?? 0)));
      band(pen, xs, side(1), side(-1), token("model"), 0.15);
    }
    if (data.places) drawPlaces(pen, plot, data.places);
    if (before) line(pen, xs, before.map(plot.y), token("before"), 1.25);
    line(pen, xs, ys, token("model"), 1.5);
  });
  dots(pen, xs, ys, token("model"), 2.6);
  ring(pen, [xs[active]!, ys[active]!], 6, token("drag"), token("paper"), 2);
  return plot;
}

function drawPlaces(pen: Pen, plot: Area, { x, value }: { x: ArrayLike<number>; value: ArrayLike<number> }): void {
  pen.fillStyle = token("quiet");
  for (let k = 0; k < x.length; k++) pen.fillRect(plot.x(x[k]!) - 1, plot.y(value[k]!) - 1, 2, 2);
}

/** Hatch the surroundings of the points without data, half way to their neighbours. */
export function hatchPoints(pen: Pen, box: Box, xs: readonly number[], empty: readonly boolean[]): void {
  pen.beginPath();
  xs.forEach((x, k) => {
    if (!empty[k]) return;
    const left = k > 0 ? (x + xs[k - 1]!) / 2 : x;
    const right = k + 1 < xs.length ? (x + xs[k + 1]!) / 2 : x;
    pen.rect(left, box.top, right - left, box.bottom - box.top);
  });
  hatch(pen);
}

/** Draw curves over one axis: the earlier in grey, the later in blue with its points. Returns the plot area. */
export function drawCurves(
  pen: Pen,
  width: number,
  height: number,
  x: readonly number[],
  before: number[],
  now: number[],
): Area {
  const box = { left: 40, right: width - 12, top: 6, bottom: height - 20 };
  const points =
    x.length === now.length
      ? [...x]
      : now.map((_, k) => x[0]! + ((x[x.length - 1]! - x[0]!) * k) / Math.max(1, now.length - 1));
  const plot = area(pen, box, widened(extent(points), 0), widened(extent(before, now), 0.08));
  const xs = points.map(plot.x);
  plot.clip(() => {
    line(pen, xs, before.map(plot.y), token("before"), 1.25);
    line(pen, xs, now.map(plot.y), token("model"), 1.5);
    dots(pen, xs, now.map(plot.y), token("model"), 2.2);
  });
  return plot;
}
