// Stacked strips with one time axis: measured black, model blue, error red. One canvas for the lines, one for the
// marks.

import type { ComponentChildren } from "preact";
import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { type Area, canvasIn, decimals, extent, line, type Pen, ticks, widened } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { ring, rules } from "../drawing/marks";
import { fixed } from "../drawing/numbers";
import { drawColumns, drawStrips } from "../drawing/strips";
import { type Drawn, drawn, sample } from "../plot-data";
import { brush, cursor, dataset, hover, isStretch, keyOf, range, visible, width } from "../plots";
import type { SignalName } from "../replies";
import { theme } from "../store";
import { active, addLine, type Row, rowAt, rows, SIGNAL } from "../strip-rows";
import { Picture } from "./picture";
import { LEFT, listen, pending, RIGHT } from "./strip-pointer";

const LOWEST = 52; // pixels of a strip of mean height; more strips scroll

/** The strips; `legends` are drawn beside them, in the same heights. */
export function Strips({ legends }: { legends: ComponentChildren }) {
  const host = useRef<HTMLDivElement>(null);
  const lines = useRef<() => void>(() => {});
  const marks = useRef<() => void>(() => {});
  const areas = useRef<Area[]>([]);

  useLayoutEffect(() => {
    const element = host.current!;
    const below = canvasIn(element, (pen, wide, high) => {
      width.value = wide - LEFT - RIGHT;
      areas.current = draw(pen, wide, high);
      marks.current();
    });
    const above = canvasIn(element, (pen) => drawMarks(pen, areas.current));
    above.canvas.style.pointerEvents = "none";
    above.canvas.style.zIndex = "1";
    lines.current = below.redraw;
    marks.current = above.redraw;
    const close = listen(below.canvas);
    return () => {
      close();
      below.close();
      above.close();
    };
  }, []);

  useEffect(() => lines.current(), [drawn.value, rows.value, theme.value]);
  useEffect(
    () => marks.current(),
    [cursor.value, hover.value, brush.value, range.value, pending.value, sample.value, active.value],
  );
  const total = rows.value.reduce((sum, row) => sum + row.weight, 0);
  return (
    <>
      <div class="strips">
        <div class="stack" style={{ minHeight: `${Math.round(total * LOWEST)}px` }}>
          {legends}
          <div
            class="canvas"
            ref={host}
            aria-label={`Strips of ${dataset.value?.name ?? ""}`}
            onDragOver={(event) => {
              if (event.dataTransfer?.types.includes(SIGNAL)) event.preventDefault();
            }}
            onDrop={drop}
          />
        </div>
      </div>
      <div class="axis">
        <span />
        <Picture label="Time axis" draw={drawAxis} of={[visible.value, cursor.value, hover.value, dataset.value]} />
      </div>
    </>
  );
}

/** Add a signal from the list to the strip that it is dropped on. */
function drop(event: DragEvent): void {
  const own = event.dataTransfer?.getData(SIGNAL);
  if (!own) return;
  event.preventDefault();
  const box = (event.currentTarget as HTMLElement).getBoundingClientRect();
  addLine(rowAt((event.clientY - box.top) / box.height), JSON.parse(own) as SignalName);
}

const timeTicks = (wide: number): number[] =>
  ticks(visible.value.begin, visible.value.end, Math.max(2, (wide - LEFT - RIGHT) / 90));

function draw(pen: Pen, wide: number, high: number): Area[] {
  const data = drawn.value;
  const { begin, end } = visible.value;
  const scale = (wide - LEFT - RIGHT) / (end - begin);
  const xs = data === null ? new Float64Array() : pixelsOf(data.x, LEFT + (data.begin - begin) * scale, scale);
  const strips = rows.value.map((row) => {
    const own = row.lines.map((each) => data?.lines.get(keyOf(each.signal)));
    const range = widened(extent(...own.filter((values) => values !== undefined)), 0.06);
    return { weight: row.weight, range, draw: (plot: Area) => drawRow(pen, plot, row, own, data, xs) };
  });
  return drawStrips(pen, wide, high, [begin, end], strips, { left: LEFT, right: RIGHT, axis: 0, gap: 5, title: "" });
}

/** Map values to pixels; a loop, because it runs over every drawn point. */
function pixelsOf(values: Float32Array, first: number, scale: number): Float64Array {
  const pixels = new Float64Array(values.length);
  for (let k = 0; k < values.length; k++) pixels[k] = first + values[k]! * scale;
  return pixels;
}

function drawRow(
  pen: Pen,
  plot: Area,
  row: Row,
  own: (Float32Array | undefined)[],
  data: Drawn | null,
  xs: Float64Array,
): void {
  if (data === null) return;
  if (own.every((values) => values === undefined || !values.some(Number.isFinite))) {
    pen.fillStyle = token("quiet");
    pen.fillText("no values in this stretch", plot.box.left + 10, (plot.box.top + plot.box.bottom) / 2 + 4);
  }
  if (data.lit.length) drawLit(pen, plot, data, xs);
  const origin = plot.y(0);
  const scale = plot.y(1) - origin;
  const apart = data.raw && xs.length > 1 && xs[1]! - xs[0]! > 5; // so that single samples can be told apart
  const order = row.lines
    .map((_, k) => k)
    .sort((a, b) => Number(row.lines[b]!.colour === "before") - Number(row.lines[a]!.colour === "before"));
  order.forEach((k) => {
    // the start lies behind
    const values = own[k];
    if (values === undefined) return;
    const colour = token(row.lines[k]!.colour);
    const ys = pixelsOf(values, origin, scale);
    const thick = row.lines[k]!.colour !== "measured" ? 1.1 : row.lines.length > 1 ? 2 : 1.25;
    if (data.raw) line(pen, xs, ys, colour, thick);
    else drawColumns(pen, xs, ys, colour, thick);
    if (!apart) return;
    pen.fillStyle = colour;
    for (let i = 0; i < xs.length; i++) pen.fillRect(xs[i]! - 1.5, ys[i]! - 1.5, 3, 3);
  });
  rules(pen, plot, "x", dataset.value?.pieces ?? [], token("edge"));
}

/** Shade the samples that are brushed elsewhere. */
function drawLit(pen: Pen, plot: Area, data: Drawn, xs: Float64Array): void {
  pen.fillStyle = token("lit-soft");
  const half = data.raw && xs.length > 1 ? Math.max(0.75, (xs[1]! - xs[0]!) / 2) : 0.75;
  for (let k = 0; k < xs.length; k++) {
    if (!(data.lit[k]! > 0)) continue;
    const first = k;
    while (k + 1 < xs.length && data.lit[k + 1]! > 0) k++;
    pen.fillRect(xs[first]! - half, plot.box.top, xs[k]! - xs[first]! + 2 * half, plot.box.bottom - plot.box.top);
  }
}

function drawMarks(pen: Pen, plots: Area[]): void {
  const first = plots[0];
  if (first === undefined) return;
  const own = isStretch(brush.value) ? brush.value : null;
  for (const [stretch, colour] of [
    [own, "lit"],
    [range.value, "accent"],
    [pending.value, "accent"],
  ] as const) {
    if (stretch === null) continue;
    const [a, b] = [Math.max(LEFT, first.x(stretch.begin)), Math.min(first.box.right, first.x(stretch.end))];
    if (b < a) continue;
    for (const { box } of plots) {
      pen.globalAlpha = 0.16;
      pen.fillStyle = token(colour);
      pen.fillRect(a, box.top, b - a, box.bottom - box.top);
      pen.globalAlpha = 1;
      pen.strokeStyle = token(colour);
      pen.lineWidth = 1;
      pen.strokeRect(Math.round(a) + 0.5, box.top, Math.round(b - a), box.bottom - box.top);
    }
  }
  if (hover.value !== null) vertical(pen, plots, hover.value, "edge", []);
  if (cursor.value !== null) vertical(pen, plots, cursor.value, "ink", [3, 3]);
  if (cursor.value !== null && sample.value?.position === cursor.value) drawSample(pen, plots, sample.value.values);
}

function vertical(pen: Pen, plots: Area[], position: number, colour: string, dashes: number[]): void {
  const x = Math.round(plots[0]!.x(position)) + 0.5;
  if (x < LEFT || x > plots[0]!.box.right) return;
  pen.setLineDash(dashes);
  pen.strokeStyle = token(colour);
  pen.lineWidth = 1;
  pen.beginPath();
  pen.moveTo(x, plots[0]!.box.top);
  pen.lineTo(x, plots[plots.length - 1]!.box.bottom);
  pen.stroke();
  pen.setLineDash([]);
}

/** A dot on each line at the cursor. */
function drawSample(pen: Pen, plots: Area[], values: Map<string, number>): void {
  rows.value.forEach((row, r) => {
    const plot = plots[r];
    plot?.clip(() =>
      row.lines.forEach((each) => {
        const value = values.get(keyOf(each.signal)) ?? NaN;
        if (!Number.isFinite(value)) return;
        ring(pen, [plot.x(cursor.value!), plot.y(value)], 3.4, token(each.colour), token("paper"), 1);
      }),
    );
  });
}

function drawAxis(pen: Pen, wide: number): void {
  const { begin, end } = visible.value;
  const x = (value: number) => LEFT + ((value - begin) / (end - begin)) * (wide - LEFT - RIGHT);
  const marks = timeTicks(wide);
  pen.fillStyle = token("quiet");
  pen.textBaseline = "top";
  pen.textAlign = "center";
  for (const value of marks) pen.fillText(fixed(value, decimals(marks)), Math.min(x(value), wide - 16), 2);
  pen.textAlign = "right";
  pen.fillText(dataset.value?.timed ? "time [s]" : "point", wide - RIGHT, 15);
  const at = hover.value ?? cursor.value;
  if (at === null || at < begin || at > end) return;
  const text = fixed(at, decimals(ticks(begin, end, 400)));
  const half = pen.measureText(text).width / 2 + 6;
  const middle = Math.max(half, Math.min(wide - half, Math.round(x(at))));
  pen.fillStyle = token("ink");
  pen.fillRect(middle - half, 0, 2 * half, 16);
  pen.fillStyle = token("paper");
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, middle, 8.5);
}
