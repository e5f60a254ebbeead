// A proposed term: its curve or map over the channels and the errors without and with it, or its answer to a step.

import { area, type Box, drawUpright, extent, line, type Pen, widened } from "./canvas";
import { css, diverging, token } from "./colours";
import { drawCells, drawScale } from "./grid";
import { band, dots, rules } from "./marks";
import { counted, plain, significant, unitText, withUnit } from "./numbers";
import { lastUpTo, nearest } from "./strips";

/** A fitted term, or one without effect; a map has its values row by row, one row for each of `points`. */
export interface Term {
  input: string;
  inputUnit: string;
  second: string;
  secondUnit: string;
  points: readonly number[];
  secondPoints: readonly number[];
  now: readonly number[];
  deviation: readonly (number | null)[];
  valueUnit: string;
  neutral: number;
  fitted: boolean;
  criterion: string;
  unit: string;
  counts: readonly number[];
}

/** Mean errors by bin of the channel, without the term and with it, and some samples with their errors without it. */
export interface TermErrors {
  edges: ArrayLike<number>;
  before: ArrayLike<number>;
  after: ArrayLike<number>;
  x: ArrayLike<number>;
  error: ArrayLike<number>;
}

/** Reads a picture at a pixel: lines of text; null where nothing is drawn. */
export type ReadTerm = (x: number, y: number) => string[] | null;

const STEPS = 80; // of a step response

/** Draw a curve or map above the errors over its first channel and the samples; returns how it is read at a pixel. */
export function drawTerm(
  pen: Pen,
  width: number,
  height: number,
  head: Term,
  errors: TermErrors,
  kind: string,
  node: string,
): ReadTerm | undefined {
  const { edges, before, after } = errors;
  const range = widened(extent(head.points, edges.length ? [edges[0]!, edges[edges.length - 1]!] : []), 0.01);
  const [left, right, counts] = [54, width - 14, 26];
  const middle = Math.max(90, Math.round((height - counts - 40) * 0.56));
  const upper = { left, right, top: 10, bottom: middle };
  if (head.second) drawMap(pen, upper, head, kind, node);
  else drawCurve(pen, upper, range, head, kind, node);
  drawErrors(pen, { left, right, top: middle + 10, bottom: height - counts - 38 }, range, head, errors);
  drawCounts(pen, { left, right, top: height - counts - 32, bottom: height - 34 }, range, head, edges);
  if (head.second) return undefined; // its cells have their numbers
  return (x) => {
    const at = range[0] + ((x - left) / (right - left)) * (range[1] - range[0]);
    const k = Math.max(0, nearest(head.points, at));
    const bin = lastUpTo(edges, at);
    if (head.points.length === 0 || x < left || x > right) return null;
    const deviation = head.deviation[k] ? ` ± ${significant(head.deviation[k], 2)}` : "";
    return [
      `${kind === "multiply" ? "factor" : "added"} ${significant(head.now[k]!)}${deviation}`,
      `${head.input} ${plain(head.points[k]!, 4)} ${unitText(head.inputUnit)}`.trim(),
      ...(bin < before.length
        ? [`mean error ${significant(before[bin]!, 3)} without, ${significant(after[bin]!, 3)} with it`]
        : []),
      ...(bin < head.counts.length ? [counted(head.counts[bin]!, "sample")] : []),
    ];
  };
}

/** Draw the values of a map as cells with their numbers: the first channel to the right, the second one upwards. */
function drawMap(pen: Pen, { left, right, top, bottom }: Box, head: Term, kind: string, node: string): void {
  const [nx, ny] = [head.points.length, head.secondPoints.length];
  const box = { left: left + 12, right: right - 52, top: top + 18, bottom: bottom - 34 };
  const at = (i: number, j: number) => head.now[i * ny + j] ?? NaN;
  const reach = Math.max(...head.now.map((value) => Math.abs(value - head.neutral))) || 1;
  const paint = (value: number) => css(diverging((value - head.neutral) / reach));
  const cell = drawCells(pen, box, nx, ny, (i, j) => (Number.isFinite(at(i, j)) ? paint(at(i, j)) : null));
  const bar = { left: right - 46, right: right - 38, top: box.top, bottom: box.bottom };
  drawScale(pen, bar, [head.neutral - reach, head.neutral + reach], paint);
  pen.textBaseline = "middle";
  for (let i = 0; i < nx; i++) {
    for (let j = 0; j < ny; j++) {
      const own = cell(i, j);
      const text = significant(at(i, j), 2);
      pen.textAlign = "center";
      // the ends of the scale are as dark, or as bright, as the ink
      pen.fillStyle = token(Math.abs(at(i, j) - head.neutral) > 0.7 * reach ? "paper" : "ink");
      if (pen.measureText(text).width < own.right - own.left - 4 && own.bottom - own.top >= 11)
        pen.fillText(text, (own.left + own.right) / 2, (own.top + own.bottom) / 2);
    }
  }
  pen.fillStyle = token("quiet");
  head.points.forEach((value, i) => {
    const own = cell(i, 0);
    pen.textAlign = "center";
    pen.fillText(plain(value, 3), (own.left + own.right) / 2, box.bottom + 9);
  });
  head.secondPoints.forEach((value, j) => {
    const own = cell(0, j);
    pen.textAlign = "right";
    pen.fillText(plain(value, 3), box.left - 5, (own.top + own.bottom) / 2);
  });
  pen.textBaseline = "alphabetic";
  pen.textAlign = "right";
  pen.fillText(withUnit(head.input, head.inputUnit), box.right, box.bottom + 28);
  pen.textAlign = "left";
  drawUpright(pen, box, withUnit(head.second, head.secondUnit));
  note(pen, effect(kind, node, head.valueUnit), box.left, top + 9, "text");
  note(pen, `no term: ${head.neutral}`, box.right, top + 9, "quiet", "right");
}

/** What the values of a curve or map do, with their unit. */
const effect = (kind: string, node: string, unit: string): string =>
  kind === "multiply" ? `factor on ${node}` : withUnit(`added to ${node}`, unit);

function drawCurve(
  pen: Pen,
  upper: Box,
  range: readonly [number, number],
  head: Term,
  kind: string,
  node: string,
): void {
  const spread = head.points.map((_, k) => head.deviation[k] ?? 0);
  const ends = head.now.flatMap((value, k) => [value - spread[k]!, value + spread[k]!]);
  const plot = area(pen, upper, range, widened(extent(ends, [head.neutral]), 0.12), { unlabelled: true });
  const [xs, ys] = [head.points.map(plot.x), head.now.map(plot.y)];
  plot.clip(() => {
    rules(pen, plot, "y", [head.neutral], token("before"));
    const side = (sign: number) => head.now.map((value, k) => plot.y(value + sign * spread[k]!));
    band(pen, xs, side(1), side(-1), token("model"), 0.18);
    line(pen, xs, ys, token("model"), 1.6);
  });
  dots(pen, xs, ys, token("model"), 3.4);
  note(pen, effect(kind, node, head.valueUnit), upper.left + 8, upper.top + 13, "text");
  note(pen, `no term: ${head.neutral}`, upper.right - 8, plot.y(head.neutral) + 12, "quiet", "right");
}

/** Draw the errors of some samples over the channel, and their mean without the term and with it. */
function drawErrors(
  pen: Pen,
  box: { left: number; right: number; top: number; bottom: number },
  range: readonly [number, number],
  head: Term,
  own: TermErrors,
): void {
  if (own.x.length === 0 || box.bottom - box.top < 40) return;
  const sizes = Array.from(own.error, Math.abs)
    .filter(Number.isFinite)
    .toSorted((a, b) => a - b);
  const most = Math.max(sizes[Math.floor(0.98 * (sizes.length - 1))] ?? 1, ...extent(own.before).map(Math.abs)) || 1;
  const plot = area(pen, box, range, [-1.15 * most, 1.15 * most], { unlabelled: true });
  const centres = Array.from(own.before, (_, k) => plot.x((own.edges[k]! + own.edges[k + 1]!) / 2));
  plot.clip(() => {
    rules(pen, plot, "y", [0], token("edge"));
    pen.globalAlpha = 0.45;
    dots(pen, Array.from(own.x, plot.x), Array.from(own.error, plot.y), token("error-before"), 1.3);
    pen.globalAlpha = 1;
    line(pen, centres, Array.from(own.before, plot.y), token("before"), 1.8);
    line(pen, centres, Array.from(own.after, plot.y), token("model"), 1.8);
  });
  note(pen, withUnit(`error of ${head.criterion}`, head.unit), box.left + 8, box.top + 13, "text");
  if (box.right - box.left < 360) return;
  const legend = head.fitted ? "mean: grey without, blue with the term" : "grey: mean without the term";
  note(pen, legend, box.right - 8, box.top + 13, "quiet", "right");
}

function drawCounts(
  pen: Pen,
  box: { left: number; right: number; top: number; bottom: number },
  range: readonly [number, number],
  head: Term,
  edges: ArrayLike<number>,
): void {
  const most = Math.max(1, ...head.counts);
  const plot = area(pen, box, range, [0, 1.1 * most], {
    unlabelledY: true,
    yTicks: [],
    title: withUnit(head.input, head.inputUnit),
  });
  pen.fillStyle = token("before");
  head.counts.forEach((count, k) => {
    const [left, right] = [plot.x(edges[k]!), plot.x(edges[k + 1]!)];
    const top = plot.y(count);
    pen.fillRect(left + 0.75, top, Math.max(1, right - left - 1.5), box.bottom - top);
  });
  note(pen, "samples", box.left - 5, box.top + 16, "quiet", "right");
}

/** Draw the answer of a lag or a delay to a step, with that of a time constant by one deviation more or less. */
export function drawStep(pen: Pen, width: number, height: number, head: Term, kind: string, change: string): void {
  const box = { left: 54, right: width - 14, top: 12, bottom: height - 38 };
  const seconds = head.now[0] ?? 0;
  const deviation = head.deviation[0] ?? 0;
  if (kind === "delay") {
    note(pen, `${change}: the values arrive later, unchanged.`, 16, 28, "quiet");
    return;
  }
  const end = 5 * (seconds || 1);
  const times = Array.from({ length: STEPS + 1 }, (_, k) => (end * k) / STEPS);
  const plot = area(pen, box, [0, end], [0, 1.1], { title: "time [s]" });
  const answer = (constant: number) => times.map((t) => plot.y(constant > 0 ? 1 - Math.exp(-t / constant) : 1));
  const xs = times.map(plot.x);
  plot.clip(() => {
    rules(pen, plot, "y", [1], token("before"));
    band(pen, xs, answer(Math.max(seconds - deviation, 0)), answer(seconds + deviation), token("model"), 0.18);
    line(pen, xs, answer(seconds), token("model"), 1.6);
    rules(pen, plot, "x", [seconds], token("edge"), [3, 3]);
  });
  const spread = deviation > 0 ? ` ± ${significant(deviation, 2)}` : "";
  note(pen, `${significant(seconds, 3)}${spread} s`, plot.x(seconds) + 6, box.bottom - 10, "text");
}

function note(pen: Pen, text: string, x: number, y: number, colour: string, align: CanvasTextAlign = "left"): void {
  pen.textAlign = align;
  const wide = pen.measureText(text).width;
  pen.globalAlpha = 0.8;
  pen.fillStyle = token("paper");
  pen.fillRect(align === "right" ? x - wide - 2 : x - 2, y - 9, wide + 4, 12);
  pen.globalAlpha = 1;
  pen.fillStyle = token(colour);
  pen.fillText(text, x, y);
  pen.textAlign = "left";
}
