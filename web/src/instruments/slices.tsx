// A curve, or a slice of a map through the active point; its points can be dragged.

import { useLayoutEffect, useRef } from "preact/hooks";
import { type Area, canvasIn, type Range } from "../drawing/canvas";
import { plain, withUnit } from "../drawing/numbers";
import { drawSlice, type SliceData } from "../drawing/slices";
import { tipOn } from "../hover-tip";
import type { EditedTable } from "../replies";
import { endDrag, selection, setValues, theme } from "../store";
import { placesOf } from "./coverage";
import { shownMarks } from "./map-table";
import { valueTip } from "./surface";
import { cellAt } from "./table-cells";
import { describeCells } from "./table-edits";

/** The cells along one axis through the active point. */
function along(own: EditedTable, axis: 0 | 1): number[] {
  const [i, j] = selection.value.active;
  return (own.axes[axis]?.points ?? []).map((_, k) => (axis === 0 ? cellAt(own, k, j) : cellAt(own, i, k)));
}

function sliceOf(own: EditedTable, axis: 0 | 1): SliceData {
  const cells = along(own, axis);
  const { input, unit, points } = own.axes[axis]!;
  const other = own.axes[1 - axis];
  const through = other
    ? ` at ${plain(other.points[selection.value.active[1 - axis]!]!, 4)} ${other.unit || other.input}`
    : "";
  const pick = <T,>(values: readonly T[]) => cells.map((cell) => values[cell]!);
  return {
    points,
    now: pick(own.values),
    before: shownMarks.value.ghost ? pick(own.reference) : null,
    deviation: own.deviation && pick(own.deviation),
    empty: own.samples && pick(own.samples).map((count) => count === 0),
    active: selection.value.active[axis]!,
    title: withUnit(input, unit) + through,
    places: placesNear(own, axis),
  };
}

/** The data points nearer to the slice than to those beside it. */
function placesNear(own: EditedTable, axis: 0 | 1): { x: number[]; value: number[] } | null {
  const places = placesOf(own);
  if (places === null) return null;
  const [along, across] = axis === 0 ? [places.x, places.y] : [places.y, places.x];
  const points = own.axes[1 - axis]?.points;
  const at = selection.value.active[1 - axis]!;
  const low = points === undefined || at === 0 ? -Infinity : (points[at]! + points[at - 1]!) / 2;
  const high = points === undefined || at + 1 >= points.length ? Infinity : (points[at]! + points[at + 1]!) / 2;
  const near = { x: [] as number[], value: [] as number[] };
  for (let k = 0; k < along.length; k++) {
    if (points !== undefined && !(across[k]! >= low && across[k]! <= high)) continue;
    near.x.push(along[k]!);
    near.value.push(places.value[k]!);
  }
  return near;
}

export function Slice({ own, axis }: { own: EditedTable; axis: 0 | 1 }) {
  const host = useRef<HTMLDivElement>(null);
  const latest = useRef(own);
  const redraw = useRef<() => void>(() => {});
  latest.current = own;

  useLayoutEffect(() => {
    let plot: Area | null = null;
    let frozen: Range | null = null;
    let drag = "";
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, width, height) => {
      plot = drawSlice(pen, width, height, sliceOf(latest.current, axis), frozen);
    });
    redraw.current = again;
    canvas.onpointerdown = (event) => {
      const index = nearest(plot, latest.current, axis, event);
      if (index === null || plot === null) return;
      canvas.setPointerCapture(event.pointerId);
      const active: [number, number] =
        axis === 0 ? [index, selection.value.active[1]] : [selection.value.active[0], index];
      selection.value = { x: [active[0], active[0]], y: [active[1], active[1]], active };
      drag = `${latest.current.name} ${event.timeStamp}`;
      frozen = [plot.yAt(plot.box.bottom), plot.yAt(plot.box.top)];
    };
    canvas.onpointermove = (event) => {
      if (drag && plot !== null) dragTo(latest.current, plot.yAt(event.offsetY), drag);
      else canvas.style.cursor = nearest(plot, latest.current, axis, event) === null ? "default" : "ns-resize";
    };
    canvas.onpointerup = canvas.onpointercancel = () => {
      drag = "";
      frozen = null;
      endDrag();
      again();
    };
    const silence = tipOn(canvas, (x, y) => {
      const index = plot === null ? null : nearest(plot, latest.current, axis, { offsetX: x, offsetY: y });
      return valueTip(latest.current, index === null ? null : along(latest.current, axis)[index]!);
    });
    return () => {
      silence();
      close();
    };
  }, [axis]);

  useLayoutEffect(() => redraw.current(), [own, selection.value, theme.value, placesOf(own), shownMarks.value]);
  return <div class="canvas" ref={host} aria-label={`Slice of ${own.name} over ${own.axes[axis]?.input}`} />;
}

/** The number of the point under the pointer. */
function nearest(
  plot: Area | null,
  own: EditedTable,
  axis: 0 | 1,
  event: Pick<PointerEvent, "offsetX" | "offsetY">,
): number | null {
  if (plot === null) return null;
  let [best, index]: [number, number | null] = [16, null];
  along(own, axis).forEach((cell, k) => {
    const distance = Math.hypot(
      plot.x(own.axes[axis]!.points[k]!) - event.offsetX,
      plot.y(own.values[cell]!) - event.offsetY,
    );
    if (distance < best) [best, index] = [distance, k];
  });
  return index;
}

function dragTo(own: EditedTable, target: number, drag: string): void {
  const cell = cellAt(own, ...selection.value.active);
  if (own.locked.includes(cell)) return;
  const value = Number(target.toPrecision(5));
  const bounded = Math.max(own.lower[cell] ?? -Infinity, Math.min(own.upper[cell] ?? Infinity, value));
  setValues([cell], [bounded], `Dragged ${describeCells(own, selection.value)}`, drag);
}
