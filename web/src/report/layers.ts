// The layers of a chart: each knows its data and draws itself into a plot area.

import { type Area, line, type Pen } from "../drawing/canvas";
import { css, family } from "../drawing/colours";
import * as marks from "../drawing/marks";
import { drawColumns, within } from "../drawing/strips";
import { paint } from "./elements";

export interface Layer {
  name?: string; // in the legend
  colour: string; // a name of the style sheet, or a colour
  off?: boolean; // hidden at first
  x?: ArrayLike<number>;
  y?: ArrayLike<number>;
  y2?: ArrayLike<number>;
  reach?: readonly number[]; // further values that the axis takes in
  rising?: boolean; // x rises
  draw: (pen: Pen, plot: Area) => void;
}

type Points = Layer & { x: ArrayLike<number>; y: ArrayLike<number> };

/** The points of a trace: samples if it is whole, else minimum and maximum of each group at the same x. */
export interface TraceSource {
  x: ArrayLike<number>;
  y: ArrayLike<number>;
  whole: boolean;
  breaks: ReadonlySet<number>;
}

interface LineOptions {
  name?: string;
  off?: boolean;
  width?: number;
  opacity?: number;
  dots?: number;
  hollow?: boolean[] | null;
  breaks?: ReadonlySet<number>;
}

const at = (values: ArrayLike<number>, scale: (value: number) => number) =>
  Float64Array.from(values as ArrayLike<number>, (value) => scale(value));

/** A line through points, with dots of a radius if `dots` is given. */
export function lineLayer(
  colour: string,
  x: ArrayLike<number>,
  y: ArrayLike<number>,
  options: LineOptions = {},
): Points {
  const { name, off, width = 1.2, opacity = 1, dots, hollow, breaks } = options;
  return {
    name,
    off,
    colour,
    x,
    y,
    draw(pen, plot) {
      const [xs, ys] = [at(x, plot.x), at(y, plot.y)];
      pen.globalAlpha = opacity;
      line(pen, xs, ys, paint(colour), width, breaks);
      if (dots) marks.dots(pen, xs, ys, paint(colour), dots, hollow ?? undefined);
      pen.globalAlpha = 1;
    },
  };
}

const DENSE = 3; // points of a pixel from which their extremes are drawn
const DOTTED = 200; // samples up to which each has a dot

/** A trace over rising x, of which the part in view is drawn; `source` may give other points each time. */
export function tracesLayer(
  colour: string,
  source: () => TraceSource,
  options: { name?: string; off?: boolean; width: number; opacity?: number },
): Points {
  return {
    name: options.name,
    off: options.off,
    colour,
    rising: true,
    get x() {
      return source().x;
    },
    get y() {
      return source().y;
    },
    draw(pen, plot) {
      const { x, y, whole, breaks } = source();
      const [first, end] = within(x, [plot.xAt(plot.box.left), plot.xAt(plot.box.right)]);
      pen.globalAlpha = options.opacity ?? 1;
      if (end - first > DENSE * (plot.box.right - plot.box.left))
        drawDense(pen, plot, { x, y }, first, end, paint(colour), options.width);
      else {
        const [xs, ys] = [
          Float64Array.from({ length: end - first }, (_, k) => plot.x(x[first + k]!)),
          Float64Array.from({ length: end - first }, (_, k) => plot.y(y[first + k]!)),
        ];
        line(pen, xs, ys, paint(colour), options.width, new Set([...breaks].map((k) => k - first)));
        if (whole && end - first <= DOTTED) marks.dots(pen, xs, ys, paint(colour), 1.8);
      }
      pen.globalAlpha = 1;
    },
  };
}

/** Draw the extremes of the points of each pixel. */
function drawDense(
  pen: Pen,
  plot: Area,
  { x, y }: { x: ArrayLike<number>; y: ArrayLike<number> },
  first: number,
  end: number,
  colour: string,
  width: number,
): void {
  const [xs, ys]: [number[], number[]] = [[], []];
  let [pixel, low, high] = [NaN, Infinity, -Infinity];
  const finish = () => {
    if (!(low <= high)) return;
    xs.push(pixel + 0.5, pixel + 0.5);
    ys.push(plot.y(low), plot.y(high));
  };
  for (let k = first; k < end; k++) {
    const at = Math.floor(plot.x(x[k]!));
    if (at !== pixel) {
      finish();
      [pixel, low, high] = [at, Infinity, -Infinity];
    }
    const value = y[k]!;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  finish();
  drawColumns(pen, xs, ys, colour, width);
}

export function dotsLayer(
  colour: string,
  name: string,
  x: ArrayLike<number>,
  y: ArrayLike<number>,
  radius: number,
  opacity: number,
): Points {
  return {
    name,
    colour,
    x,
    y,
    draw(pen, plot) {
      pen.globalAlpha = opacity;
      marks.dots(pen, at(x, plot.x), at(y, plot.y), paint(colour), radius);
      pen.globalAlpha = 1;
    },
  };
}

export function bandLayer(
  colour: string,
  x: ArrayLike<number>,
  y: ArrayLike<number>,
  y2: ArrayLike<number>,
  opacity: number,
  name?: string,
): Layer {
  return {
    name,
    colour,
    x,
    y,
    y2,
    draw: (pen, plot) => marks.band(pen, at(x, plot.x), at(y, plot.y), at(y2, plot.y), paint(colour), opacity),
  };
}

export function stemsLayer(colour: string, x: ArrayLike<number>, y: ArrayLike<number>, width: number): Layer {
  return {
    colour,
    x,
    y,
    draw: (pen, plot) => marks.stems(pen, at(x, plot.x), at(y, plot.y), plot.y(0), paint(colour), width),
  };
}

/** Bars of equal width between two ends. */
export function barsLayer(
  colour: string,
  name: string,
  ends: readonly [number, number],
  counts: readonly number[],
  opacity = 0.85,
): Layer {
  const [low, high] = ends;
  const wide = (high - low) / counts.length;
  return {
    name,
    colour,
    x: ends,
    reach: [0, Math.max(...counts)],
    draw(pen, plot) {
      pen.fillStyle = paint(colour);
      pen.globalAlpha = opacity;
      counts.forEach((count, k) => {
        const [left, right] = [plot.x(low + k * wide), plot.x(low + (k + 1) * wide)];
        pen.fillRect(left, plot.y(count), Math.max(right - left - 0.5, 0.7), plot.y(0) - plot.y(count));
      });
      pen.globalAlpha = 1;
    },
  };
}

export function levelLayer(
  colour: string,
  values: readonly number[],
  options: { name?: string; dash?: number[]; reach?: readonly number[] } = {},
): Layer {
  return {
    name: options.name,
    reach: options.reach,
    colour,
    draw: (pen, plot) => marks.rules(pen, plot, "y", values, paint(colour), options.dash),
  };
}

export function uprightLayer(colour: string, values: readonly number[], dash: number[], name?: string): Layer {
  return { name, colour, draw: (pen, plot) => marks.rules(pen, plot, "x", values, paint(colour), dash) };
}

/** The line on which calculated equals measured. */
export function diagonalLayer(colour: string): Layer {
  return {
    colour,
    draw(pen, plot) {
      const ends = [plot.xAt(plot.box.left), plot.xAt(plot.box.right)];
      line(pen, at(ends, plot.x), at(ends, plot.y), paint(colour), 1);
    },
  };
}

/** Lines of a family, coloured in their order; the colours follow the theme. */
export function familyLayer(share: number, x: ArrayLike<number>, y: ArrayLike<number>): Points {
  const layer = lineLayer("", x, y);
  layer.draw = (pen, plot) => {
    const colour = css(family(share));
    line(pen, at(x, plot.x), at(y, plot.y), colour, 1.4);
    marks.dots(pen, at(x, plot.x), at(y, plot.y), colour, 1.7);
  };
  return layer;
}

export type { Points };
