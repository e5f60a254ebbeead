// Stacked strips with one time axis: measured black, model blue, error red. One canvas for the lines, one for the cursor.

import { useEffect, useRef } from "preact/hooks";
import { canvasIn, decimals, extent, line, ticks, widened, type Area, type Pen } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { rules } from "../drawing/marks";
import { MISSING, fixed, significant } from "../drawing/numbers";
import { drawStrips, lastUpTo } from "../drawing/strips";
import { back, brush, cursor, dataset, drawn, overview, range, rows, visible, width, zoom, zoomAt, type Drawn, type Line, type Row, type Stretch } from "../plots";
import { theme } from "../store";
import { tool } from "../screens/plots";

const LEFT = 44;
const RIGHT = 12;
const AXIS = 30; // pixels below the last strip

export function Strips() {
  const host = useRef<HTMLDivElement>(null);
  const lines = useRef<() => void>(() => {});
  const marks = useRef<() => void>(() => {});
  const areas = useRef<Area[]>([]);

  useEffect(() => {
    const element = host.current!;
    const below = canvasIn(element, (pen, wide, high) => {
      width.value = wide - LEFT - RIGHT;
      areas.current = draw(pen, wide, high);
      marks.current();
    });
    const above = canvasIn(element, (pen, _, high) => drawMarks(pen, areas.current, high));
    above.canvas.style.pointerEvents = "none";
    above.canvas.style.zIndex = "1";
    lines.current = below.redraw;
    marks.current = above.redraw;
    const close = listen(below.canvas);
    return () => { close(); below.close(); above.close(); };
  }, []);

  useEffect(() => lines.current(), [drawn.value, rows.value, theme.value]);
  useEffect(() => marks.current(), [cursor.value, brush.value, range.value]);
  return (
    <div class="strips">
      <div class="legends">
        {rows.value.map((row) => (
          <div class="leg" style={{ flex: row.weight }}>
            <div class="nm"><b class="cut">{row.title}</b><span class="q">{row.unit}</span></div>
            {row.lines.map((each) => <Value own={each} />)}
          </div>
        ))}
        <div style={{ height: `${AXIS}px` }} />
      </div>
      <div class="canvas" ref={host} aria-label={`Strips of ${dataset.value?.name ?? ""}`} />
    </div>
  );
}

function Value({ own }: { own: Line }) {
  const all = rows.value.flatMap((row) => row.lines);
  return (
    <div class="v"><i style={{ background: `var(--${own.colour})` }} /><span>{own.label}</span><b>{valueAt(drawn.value, all.indexOf(own), cursor.value)}</b></div>
  );
}

/** The drawn value at a position: of the sample before it, or the middle of the pixel. */
function valueAt(data: Drawn | null, number: number, at: number | null): string {
  const values = data?.lines[number];
  if (data === null || values === undefined || at === null) return MISSING;
  const low = lastUpTo(data.x, at - data.begin);
  const value = data.raw ? values[low]! : (values[low & ~1]! + values[low | 1]!) / 2;
  return significant(value);
}

function draw(pen: Pen, wide: number, high: number): Area[] {
  const data = drawn.value;
  let number = 0;
  const strips = rows.value.map((row) => {
    const own = row.lines.map(() => data?.lines[number++]).filter((values) => values !== undefined);
    return { weight: row.weight, range: widened(extent(...own), 0.06), draw: (plot: Area) => drawLines(pen, plot, row, own) };
  });
  const { begin, end } = visible.value;
  return drawStrips(pen, wide, high, [begin, end], strips, { left: LEFT, right: RIGHT, axis: AXIS, gap: 5, title: dataset.value?.timed ? "time [s]" : "point" });
}

function drawLines(pen: Pen, plot: Area, row: Row, traces: Float32Array[]): void {
  const data = drawn.value;
  if (data === null) return;
  const xs = Float64Array.from(data.x, (x) => plot.x(x + data.begin));
  traces.forEach((values, k) => line(pen, xs, Float64Array.from(values, plot.y), token(row.lines[k]!.colour), row.lines[k]!.colour === "measured" ? 1.25 : 1.1));
  rules(pen, plot, "x", dataset.value?.pieces ?? [], token("edge"));
}

function drawMarks(pen: Pen, plots: Area[], high: number): void {
  const first = plots[0];
  if (first === undefined) return;
  for (const [part, colour] of [[brush.value, "lit"], [range.value, "accent"]] as const) {
    if (part === null) continue;
    const [a, b] = [Math.max(LEFT, first.x(part.begin)), Math.min(first.box.right, first.x(part.end))];
    if (b < a) continue;
    for (const plot of plots) {
      pen.globalAlpha = 0.16;
      pen.fillStyle = token(colour);
      pen.fillRect(a, plot.box.top, b - a, plot.box.bottom - plot.box.top);
      pen.globalAlpha = 1;
      pen.strokeStyle = token(colour);
      pen.lineWidth = 1;
      pen.strokeRect(Math.round(a) + 0.5, plot.box.top, Math.round(b - a), plot.box.bottom - plot.box.top);
    }
  }
  const at = cursor.value;
  if (at === null) return;
  const x = Math.round(first.x(at)) + 0.5;
  if (x < LEFT || x > first.box.right) return;
  pen.setLineDash([3, 3]);
  pen.strokeStyle = token("axis");
  pen.beginPath();
  pen.moveTo(x, first.box.top);
  pen.lineTo(x, plots[plots.length - 1]!.box.bottom);
  pen.stroke();
  pen.setLineDash([]);
  const { begin, end } = visible.value;
  const text = fixed(at, decimals(ticks(begin, end, 400)));
  const half = pen.measureText(text).width / 2 + 6;
  pen.fillStyle = token("ink");
  pen.fillRect(x - half, high - AXIS + 2, 2 * half, 16);
  pen.fillStyle = token("paper");
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, x, high - AXIS + 10);
}

function listen(canvas: HTMLCanvasElement): () => void {
  let from: number | null = null;
  const position = (event: MouseEvent) => {
    const box = canvas.getBoundingClientRect();
    const { begin, end } = visible.value;
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return begin + Math.max(0, Math.min(1, share)) * (end - begin);
  };
  const between = (a: number, b: number): Stretch => ({ begin: Math.min(a, b), end: Math.max(a, b) });
  const target = () => (tool.value === "brush" ? brush : range);
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    from = position(event);
  };
  canvas.onpointermove = (event) => {
    cursor.value = position(event);
    if (from !== null) target().value = between(from, cursor.value);
  };
  canvas.onpointerup = (event) => {
    const to = position(event);
    const part = from === null ? null : between(from, to);
    from = null;
    const { begin, end } = visible.value;
    const small = part === null || part.end - part.begin < (end - begin) / 200;
    if (tool.value === "zoom") {
      range.value = null;
      if (!small) zoom(part);
    } else if (small) target().value = null;
  };
  canvas.onpointerleave = () => { if (from === null) cursor.value = null; };
  const wheel = (event: WheelEvent) => {
    event.preventDefault();
    zoomAt(position(event), Math.exp(event.deltaY * 0.0015));
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
  canvas.ondblclick = back;
  return () => canvas.removeEventListener("wheel", wheel);
}

/** The whole dataset, small, with the stretch that the strips show. */
export function Overview() {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  useEffect(() => {
    const { canvas, redraw: again, close } = canvasIn(host.current!, (pen, wide, high) => {
      const data = overview.value;
      const own = dataset.value;
      if (data === null || own === undefined) return;
      const x = (value: number) => LEFT + ((value - own.begin) / (own.end - own.begin)) * (wide - LEFT - RIGHT);
      const [low, most] = widened(extent(data.lines[0]!), 0.08);
      line(pen, Float64Array.from(data.x, (value) => x(value + data.begin)), Float64Array.from(data.lines[0]!, (value) => high - 4 - ((value - low) / (most - low)) * (high - 8)), token("before"), 1);
      const { begin, end } = visible.value;
      pen.fillStyle = token("accent");
      pen.globalAlpha = 0.14;
      pen.fillRect(x(begin), 1, x(end) - x(begin), high - 2);
      pen.globalAlpha = 1;
      pen.strokeStyle = token("accent");
      pen.strokeRect(x(begin) + 0.5, 1.5, x(end) - x(begin) - 1, high - 3);
    });
    redraw.current = again;
    let grip: number | null = null;
    const position = (event: PointerEvent) => {
      const own = dataset.value!;
      const box = canvas.getBoundingClientRect();
      return own.begin + ((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)) * (own.end - own.begin);
    };
    const move = (event: PointerEvent) => {
      const own = dataset.value!;
      const wide = visible.value.end - visible.value.begin;
      const begin = Math.max(own.begin, Math.min(own.end - wide, position(event) - grip!));
      zoomTo({ begin, end: begin + wide });
    };
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      const { begin, end } = visible.value;
      const at = position(event);
      grip = at >= begin && at <= end ? at - begin : (end - begin) / 2;
      move(event);
    };
    canvas.onpointermove = (event) => { if (grip !== null) move(event); };
    canvas.onpointerup = () => { grip = null; };
    return close;
  }, []);
  useEffect(() => redraw.current(), [overview.value, visible.value, theme.value]);
  return <div class="canvas" ref={host} aria-label="Overview of the whole dataset" />;
}

const zoomTo = (part: Stretch): void => {
  const own = dataset.value!;
  if (part.end - part.begin < own.end - own.begin) zoom(part);
};
