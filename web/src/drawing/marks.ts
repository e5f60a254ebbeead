// Marks of plots, in pixels: dots, rings, bands, stems, rules, hatching.

import type { Area, Pen } from "./canvas";
import { token } from "./colours";

/** Draw a dot at each point with a number; those in `hollow` as rings. */
export function dots(
  pen: Pen,
  xs: ArrayLike<number>,
  ys: ArrayLike<number>,
  colour: string,
  radius: number,
  hollow?: ArrayLike<boolean>,
): void {
  pen.fillStyle = colour;
  for (let k = 0; k < xs.length; k++) {
    if (!Number.isFinite(ys[k]!) || hollow?.[k]) continue;
    pen.beginPath(); // each on its own, so that translucent ones add up
    pen.arc(xs[k]!, ys[k]!, radius, 0, 7);
    pen.fill();
  }
  for (let k = 0; k < (hollow?.length ?? 0); k++) {
    if (hollow![k] && Number.isFinite(ys[k]!)) ring(pen, [xs[k]!, ys[k]!], radius, token("paper"), colour, 1.2);
  }
}

/** Draw a circle; an empty `fill` leaves it open. */
export function ring(
  pen: Pen,
  [x, y]: readonly number[],
  radius: number,
  fill: string,
  stroke: string,
  width: number,
): void {
  pen.beginPath();
  pen.arc(x!, y!, radius, 0, 7);
  if (fill) {
    pen.fillStyle = fill;
    pen.fill();
  }
  pen.strokeStyle = stroke;
  pen.lineWidth = width;
  pen.stroke();
}

/** Fill the room between two lines; NaN in either interrupts it. */
export function band(
  pen: Pen,
  xs: ArrayLike<number>,
  upper: ArrayLike<number>,
  lower: ArrayLike<number>,
  colour: string,
  opacity: number,
): void {
  const known = (k: number) => k < xs.length && Number.isFinite(upper[k]!) && Number.isFinite(lower[k]!);
  pen.beginPath();
  for (let first = 0; first < xs.length; first++) {
    if (!known(first)) continue;
    let last = first;
    while (known(last + 1)) last++;
    pen.moveTo(xs[first]!, upper[first]!);
    for (let k = first + 1; k <= last; k++) pen.lineTo(xs[k]!, upper[k]!);
    for (let k = last; k >= first; k--) pen.lineTo(xs[k]!, lower[k]!);
    pen.closePath();
    first = last;
  }
  pen.fillStyle = colour;
  pen.globalAlpha = opacity;
  pen.fill();
  pen.globalAlpha = 1;
}

/** Draw upright lines from a base. */
export function stems(
  pen: Pen,
  xs: ArrayLike<number>,
  ys: ArrayLike<number>,
  base: number,
  colour: string,
  width: number,
): void {
  pen.beginPath();
  for (let k = 0; k < xs.length; k++) {
    if (!Number.isFinite(ys[k]!)) continue;
    pen.moveTo(xs[k]!, base);
    pen.lineTo(xs[k]!, ys[k]!);
  }
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.stroke();
}

/** Draw lines across a plot area: upright at values of x, level at values of y. */
export function rules(
  pen: Pen,
  plot: Area,
  along: "x" | "y",
  values: readonly number[],
  colour: string,
  dash: number[] = [],
): void {
  const { left, right, top, bottom } = plot.box;
  pen.beginPath();
  for (const value of values) {
    const at = plot[along](value);
    pen.moveTo(along === "x" ? at : left, along === "x" ? top : at);
    pen.lineTo(along === "x" ? at : right, along === "x" ? bottom : at);
  }
  pen.strokeStyle = colour;
  pen.lineWidth = 1;
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
}

const patterns = new Map<string, CanvasPattern>();

/** Hatch the current path. */
export function hatch(pen: Pen): void {
  const [colour, ratio] = [token("hatch"), pen.getTransform().a];
  const key = `${colour} ${ratio}`;
  let pattern = patterns.get(key);
  if (pattern === undefined) {
    pattern = hatching(pen, colour, ratio);
    patterns.set(key, pattern);
  }
  pen.fillStyle = pattern;
  pen.fill();
}

/** Return diagonal lines five pixels apart as a pattern. */
function hatching(pen: Pen, colour: string, ratio: number): CanvasPattern {
  const size = Math.round(5 * ratio);
  const tile = Object.assign(document.createElement("canvas"), { width: size, height: size });
  const own = tile.getContext("2d")!;
  own.strokeStyle = colour;
  own.lineWidth = ratio;
  own.beginPath();
  for (const shift of [-size, 0, size]) {
    own.moveTo(shift, size);
    own.lineTo(shift + size, 0);
  }
  own.stroke();
  const pattern = pen.createPattern(tile, "repeat")!;
  pattern.setTransform(new DOMMatrix().scale(1 / ratio));
  return pattern;
}
