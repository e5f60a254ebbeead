// A curve, or a slice of a map through the active point: now, the reference, standard deviation; points can be dragged.

import { useEffect, useRef } from "preact/hooks";
import { area, canvasIn, extent, line, widened, type Area, type Pen } from "../drawing/canvas";
import { isDark, token } from "../drawing/colours";
import { plain } from "../drawing/numbers";
import { endDrag, selection, setValues, theme, type Table } from "../store";
import { cellAt } from "./map-table";
import { describeCells } from "./table-edits";

/** The cells along one axis through the active point. */
function along(own: Table, axis: 0 | 1): number[] {
  const [i, j] = selection.value.active;
  return (own.axes[axis]?.points ?? []).map((_, k) => (axis === 0 ? cellAt(own, k, j) : cellAt(own, i, k)));
}

export function Slice({ own, axis }: { own: Table; axis: 0 | 1 }) {
  const host = useRef<HTMLDivElement>(null);
  const latest = useRef(own);
  const redraw = useRef<() => void>(() => {});
  latest.current = own;

  useEffect(() => {
    let plot: Area | null = null;
    let frozen: readonly [number, number] | null = null;
    let drag = "";
    const { canvas, redraw: again, close } = canvasIn(host.current!, (pen, width, height) => {
      plot = draw(pen, width, height, latest.current, axis, frozen);
    });
    redraw.current = again;
    const nearest = (event: PointerEvent): number | null => {
      if (plot === null) return null;
      const box = canvas.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      const table = latest.current;
      let [best, index]: [number, number | null] = [16, null];
      along(table, axis).forEach((cell, k) => {
        const distance = Math.hypot(plot!.x(table.axes[axis]!.points[k]!) - x, plot!.y(table.values[cell]!) - y);
        if (distance < best) [best, index] = [distance, k];
      });
      return index;
    };
    canvas.onpointerdown = (event) => {
      const index = nearest(event);
      if (index === null || plot === null) return;
      canvas.setPointerCapture(event.pointerId);
      const active: [number, number] = axis === 0 ? [index, selection.value.active[1]] : [selection.value.active[0], index];
      selection.value = { x: [active[0], active[0]], y: [active[1], active[1]], active };
      drag = `${latest.current.name} ${event.timeStamp}`;
      frozen = [invert(plot, plot.box.bottom), invert(plot, plot.box.top)];
    };
    canvas.onpointermove = (event) => {
      const table = latest.current;
      if (!drag || plot === null) {
        canvas.style.cursor = nearest(event) === null ? "default" : "ns-resize";
        return;
      }
      const [i, j] = selection.value.active;
      const cell = cellAt(table, i, j);
      if (table.locked.includes(cell)) return;
      const value = Number(invert(plot, event.clientY - canvas.getBoundingClientRect().top).toPrecision(5));
      const bounded = Math.max(table.lower[cell] ?? -Infinity, Math.min(table.upper[cell] ?? Infinity, value));
      setValues([cell], [bounded], `Dragged ${describeCells(table, selection.value)}`, drag);
    };
    canvas.onpointerup = () => {
      drag = "";
      frozen = null;
      endDrag();
      again();
    };
    return close;
  }, [axis]);

  useEffect(() => redraw.current(), [own, selection.value, theme.value]);
  return <div class="canvas" ref={host} aria-label={`Slice of ${own.name} over ${own.axes[axis]?.input}`} />;
}

const invert = (plot: Area, pixel: number): number => {
  const [a, b] = [plot.y(0), plot.y(1)];
  return (pixel - a) / (b - a);
};

function draw(pen: Pen, width: number, height: number, own: Table, axis: 0 | 1, frozen: readonly [number, number] | null): Area {
  const cells = along(own, axis);
  const points = own.axes[axis]!.points;
  const now = cells.map((cell) => own.values[cell]!);
  const before = cells.map((cell) => own.reference[cell]!);
  const box = { left: 44, right: width - 14, top: 10, bottom: height - 36 };
  const range = frozen ?? widened(extent(now, before), 0.08);
  const other = own.axes[1 - axis];
  const through = other ? ` at ${plain(other.points[selection.value.active[1 - axis]!]!, 5)} ${other.unit || other.input}` : "";
  const { input, unit } = own.axes[axis]!;
  const plot = area(pen, box, widened(extent(points), 0), range, { title: `${unit && unit !== "-" ? `${input} [${unit}]` : input}${through}` });
  const xs = points.map(plot.x);
  plot.clip(() => {
    band(pen, plot, own, cells, xs);
    line(pen, xs, before.map(plot.y), token("before"), 1.25);
    line(pen, xs, now.map(plot.y), token("model"), 1.5);
  });
  pen.fillStyle = token("model");
  now.forEach((value, k) => {
    pen.beginPath();
    pen.arc(xs[k]!, plot.y(value), 2.6, 0, 7);
    pen.fill();
  });
  const active = selection.value.active[axis]!;
  pen.beginPath();
  pen.arc(xs[active]!, plot.y(now[active]!), 6, 0, 7);
  pen.fillStyle = token("drag");
  pen.fill();
  pen.strokeStyle = token("paper");
  pen.lineWidth = 2;
  pen.stroke();
  return plot;
}

/** Twice the standard deviation on both sides. */
function band(pen: Pen, plot: Area, own: Table, cells: number[], xs: number[]): void {
  if (own.deviation === null) return;
  const wide = cells.map((cell) => 2 * (own.deviation![cell] ?? 0));
  const y = (side: number) => cells.map((cell, k) => plot.y(own.values[cell]! + side * wide[k]!));
  pen.beginPath();
  const [upper, lower] = [y(1), y(-1)];
  xs.forEach((x, k) => pen[k ? "lineTo" : "moveTo"](x, upper[k]!));
  for (let k = xs.length - 1; k >= 0; k--) pen.lineTo(xs[k]!, lower[k]!);
  pen.closePath();
  pen.fillStyle = isDark() ? "rgba(116,167,242,.18)" : "rgba(31,95,191,.12)";
  pen.fill();
}
