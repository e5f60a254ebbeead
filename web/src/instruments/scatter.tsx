// A signal over another: a click puts the cursor on the nearest sample, a rectangle brushes the samples in it.

import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { type Area, area, canvasIn, extent, line, type Pen, type Range, widened } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { ring } from "../drawing/marks";
import { plain, significant, unitText } from "../drawing/numbers";
import { tipOn } from "../hover-tip";
import { sample } from "../plot-data";
import { type Brush, brush, cursor, dataset, keyOf, part } from "../plots";
import type { SignalName, SignalRange } from "../replies";
import { theme } from "../store";
import { nameOf, unitOf } from "../strip-rows";

export interface Cloud {
  y: Float32Array;
  colour: string;
}
export interface ScatterProps {
  label: string;
  signals: [SignalName, SignalName]; // over x and y
  title: string; // of the x axis
  x: Float32Array;
  clouds: Cloud[]; // the last one is that of the y signal
  lit: Float32Array;
  position: Float32Array; // of each sample on the time axis, from `begin`
  begin: number;
  diagonal?: boolean; // both axes have the same range, with the line y = x
}

export function ScatterPlot(props: ScatterProps) {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  const latest = useRef(props);
  latest.current = props;
  useLayoutEffect(() => {
    let plot: Area | null = null;
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, wide, high) => {
      plot = draw(pen, wide, high, latest.current);
    });
    redraw.current = again;
    brushing(canvas, (x, y) => (plot !== null && within(plot, x, y) ? { plot, props: latest.current } : null));
    return close;
  }, []);
  useEffect(
    () => redraw.current(),
    [props.x, props.clouds.at(-1)?.y, props.lit, props.title, brush.value, cursor.value, sample.value, theme.value],
  );
  return (
    <div class="body canvas" ref={host} aria-label={`${props.label}; drag a rectangle to brush, click for a sample`} />
  );
}

export const within = ({ box }: Area, x: number, y: number): boolean =>
  x >= box.left && x <= box.right && y >= box.top && y <= box.bottom;

type Place = { plot: Area; props: Pick<ScatterProps, "signals" | "x" | "clouds" | "position" | "begin"> };

/** Brush by dragging in the plot under the mouse; Shift keeps the ranges of other signals. */
export function brushing(canvas: HTMLCanvasElement, placeAt: (x: number, y: number) => Place | null): void {
  let from: { x: number; y: number; place: Place; others: SignalRange[] } | null = null;
  const at = (event: PointerEvent) => {
    const box = canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const moved = (event: PointerEvent) => {
    const to = at(event);
    return Math.hypot(to.x - from!.x, to.y - from!.y) > 3;
  };
  canvas.style.cursor = "crosshair";
  tipOn(canvas, (x, y) => {
    const place = placeAt(x, y);
    return place === null ? null : sampleTip(place, nearestSample(place, x, y, 8));
  });
  canvas.onpointerdown = (event) => {
    const { x, y } = at(event);
    const place = placeAt(x, y);
    if (place === null) return;
    canvas.setPointerCapture(event.pointerId);
    from = {
      x,
      y,
      place,
      others: event.shiftKey && brush.value !== null && "ranges" in brush.value ? brush.value.ranges : [],
    };
  };
  canvas.onpointermove = (event) => {
    if (from === null || !moved(event)) return;
    const { plot, props } = from.place;
    const to = at(event);
    const own = [
      rangeOf(props.signals[0], from.x, to.x, plot.box.left, plot.box.right, plot.x),
      rangeOf(props.signals[1], from.y, to.y, plot.box.bottom, plot.box.top, plot.y),
    ];
    const named = new Set(own.map((each) => keyOf(each.signal)));
    brush.value = { ranges: [...from.others.filter((each) => !named.has(keyOf(each.signal))), ...own] };
    part.value = "point";
  };
  canvas.onpointerup = (event) => {
    if (from !== null && !moved(event)) pick(from.place, from.x, from.y);
    from = null;
  };
}

/** The values between two pixels, rounded to what a pixel can tell. */
export function rangeOf(
  signal: SignalName,
  from: number,
  to: number,
  low: number,
  high: number,
  scale: (value: number) => number,
): SignalRange {
  const value = (pixel: number) => (pixel - scale(0)) / (scale(1) - scale(0));
  const inside = [from, to].map((pixel) => Math.max(Math.min(low, high), Math.min(Math.max(low, high), pixel)));
  const [a, b] = inside.map(value).sort((p, q) => p - q) as [number, number];
  const places = Math.max(0, Math.min(12, Math.ceil(-Math.log10(Math.abs(value(1) - value(0)) || 1))));
  return { signal, least: Number(a.toFixed(places)), greatest: Number(b.toFixed(places)) };
}

/** The number of the sample that is nearest to a pixel, not farther than `reach`; -1 if there is none. */
function nearestSample({ plot, props }: Place, x: number, y: number, reach: number): number {
  const ys = props.clouds.at(-1)?.y ?? new Float32Array();
  const [x0, y0] = [plot.x(0), plot.y(0)];
  const [dx, dy] = [plot.x(1) - x0, plot.y(1) - y0];
  let [best, nearest] = [reach ** 2, -1];
  for (let k = 0; k < ys.length; k++) {
    const distance = (x0 + props.x[k]! * dx - x) ** 2 + (y0 + ys[k]! * dy - y) ** 2;
    if (distance < best) [best, nearest] = [distance, k];
  }
  return nearest;
}

/** The values of a sample. */
function sampleTip({ props }: Place, k: number): string[] | null {
  if (k < 0) return null;
  const ys = props.clouds.at(-1)!.y;
  const position = plain(props.begin + props.position[k]!, 7);
  return [
    `${nameOf(props.signals[1])} ${significant(ys[k]!)} ${unitText(unitOf(props.signals[1]))}`.trim(),
    `${nameOf(props.signals[0])} ${significant(props.x[k]!)} ${unitText(unitOf(props.signals[0]))}`.trim(),
    `${dataset.value?.name ?? ""} ${dataset.value?.timed ? `at ${position} s` : `point ${position}`}`.trim(),
  ];
}

function pick(place: Place, x: number, y: number): void {
  const nearest = nearestSample(place, x, y, 20);
  if (nearest < 0) return;
  const { props } = place;
  cursor.value = props.begin + props.position[nearest]!;
  part.value = "sample";
}

function draw(pen: Pen, width: number, height: number, props: ScatterProps): Area {
  const box = { left: 44, right: width - 14, top: 8, bottom: height - 34 };
  const values = props.clouds.map((each) => each.y);
  const [xs, ys] = props.diagonal
    ? [extent(props.x, ...values), extent(props.x, ...values)]
    : [extent(props.x), extent(...values)];
  const plot = area(pen, box, widened(xs, 0.04), widened(ys, 0.04), { title: props.title });
  plot.clip(() => {
    if (props.diagonal) line(pen, [box.left, box.right], [box.bottom, box.top], token("axis"), 1);
    for (const { y, colour } of props.clouds) drawDots(pen, plot, props.x, y, token(colour));
    drawDots(pen, plot, props.x, props.clouds.at(-1)!.y, token("lit"), props.lit, 2.6);
    drawRectangle(pen, plot, brush.value, props.signals);
    drawCursor(pen, plot, props.signals);
  });
  return plot;
}

/** Draw a small square for each sample; with `lit`, only for those that are. */
export function drawDots(
  pen: Pen,
  plot: Area,
  xs: Float32Array,
  ys: Float32Array,
  colour: string,
  lit: Float32Array | null = null,
  size = 1.8,
): void {
  const [x0, y0] = [plot.x(0) - size / 2, plot.y(0) - size / 2];
  const [dx, dy] = [plot.x(1) - plot.x(0), plot.y(1) - plot.y(0)];
  pen.fillStyle = colour;
  for (let k = 0; k < ys.length; k++)
    if (lit === null || lit[k]! > 0) pen.fillRect(x0 + xs[k]! * dx, y0 + ys[k]! * dy, size, size);
}

/** Outline the brushed ranges that belong to the axes of a plot. */
export function drawRectangle(
  pen: Pen,
  plot: Area,
  own: Brush | null,
  [x, y]: readonly [SignalName, SignalName],
): void {
  if (own === null || !("ranges" in own)) return;
  const ends = (signal: SignalName, all: Range, scale: (value: number) => number): [Range, boolean] => {
    const range = own.ranges.find((each) => keyOf(each.signal) === keyOf(signal));
    return range ? [[scale(range.least), scale(range.greatest)], true] : [all, false];
  };
  const [[left, right], byX] = ends(x, [plot.box.left, plot.box.right], plot.x);
  const [[bottom, top], byY] = ends(y, [plot.box.bottom, plot.box.top], plot.y);
  if (!byX && !byY) return;
  pen.strokeStyle = token("lit");
  pen.lineWidth = 1.25;
  pen.strokeRect(left, top, right - left, bottom - top);
  pen.fillStyle = token("lit");
  pen.globalAlpha = 0.1;
  pen.fillRect(left, top, right - left, bottom - top);
  pen.globalAlpha = 1;
}

/** Ring the sample at the cursor. */
export function drawCursor(pen: Pen, plot: Area, [x, y]: readonly [SignalName, SignalName]): void {
  const own = sample.value;
  const [px, py] = [plot.x(own?.values.get(keyOf(x)) ?? NaN), plot.y(own?.values.get(keyOf(y)) ?? NaN)];
  if (cursor.value === null || !Number.isFinite(px + py)) return;
  for (const [radius, colour, thick] of [
    [5, "paper", 3],
    [5, "ink", 1.5],
  ] as const) {
    ring(pen, [px, py], radius, "", token(colour), thick);
  }
}
