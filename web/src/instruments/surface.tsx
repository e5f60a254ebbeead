// The surface of a map: drag the dot up or down, or turn the ground. A readout stays in the corner.

import { useLayoutEffect, useRef } from "preact/hooks";
import { canvasIn, type Range } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { plain, signed, significant } from "../drawing/numbers";
import { Surface as Drawing, type SurfaceMap } from "../drawing/surface";
import { tipOn } from "../hover-tip";
import type { EditedTable } from "../replies";
import { endDrag, referenceName, selection, setValues, theme } from "../store";
import { coverOf, placesOf } from "./coverage";
import { cellTitle, shownMarks } from "./map-table";
import { placeText } from "./pictures";
import { cellAt, size } from "./table-cells";
import { describeCells } from "./table-edits";

function mapOf(own: EditedTable): SurfaceMap {
  const axis = (k: number) => ({ title: own.axes[k]!.input, unit: own.axes[k]!.unit, points: own.axes[k]!.points });
  const empty = own.samples === null ? null : (cell: number) => own.samples![cell] === 0;
  return {
    x: axis(0),
    y: axis(1),
    unit: own.unit,
    now: own.values,
    reference: shownMarks.value.ghost ? own.reference : null,
    empty,
    tints: coverOf(own)?.tints,
  };
}

interface Grip {
  cell: number;
  value: number;
  y: number;
  perPixel: number;
  drag: string;
}

export function Surface({ own }: { own: EditedTable }) {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  const latest = useRef(own);
  latest.current = own;

  useLayoutEffect(() => {
    const drawing = new Drawing();
    let frozen: Range | null = null; // the height axis stays while a dot is dragged
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, width, height) => {
      const table = latest.current;
      if (table.axes.length !== 2) return;
      drawing.draw(pen, width, height, mapOf(table), frozen);
      const places = placesOf(table);
      if (places !== null) drawing.drawPlaces(pen, places.x, places.y, places.value, token("ink"));
      drawing.drawGrip(pen, cellAt(table, ...selection.value.active));
    });
    redraw.current = again;
    let grip: Grip | null = null;
    let turn: { x: number; y: number; azimuth: number; elevation: number } | null = null;
    const nearest = (event: PointerEvent) => drawing.nearest(event.offsetX, event.offsetY, 14);
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      const cell = nearest(event);
      const table = latest.current;
      if (cell === null) {
        turn = {
          x: event.clientX,
          y: event.clientY,
          azimuth: drawing.camera.azimuth,
          elevation: drawing.camera.elevation,
        };
        return;
      }
      select(table, cell);
      frozen = drawing.range;
      grip = {
        cell,
        value: table.values[cell]!,
        y: event.clientY,
        perPixel: drawing.perPixel(cell),
        drag: `${table.name} ${event.timeStamp}`,
      };
    };
    canvas.onpointermove = (event) => {
      if (turn !== null) {
        drawing.camera.turnTo(
          turn.azimuth + (event.clientX - turn.x) * 0.009,
          turn.elevation + (event.clientY - turn.y) * 0.007,
        );
        again();
      } else if (grip !== null) drag(latest.current, grip, event.clientY);
      else canvas.style.cursor = nearest(event) === null ? "grab" : "ns-resize";
    };
    canvas.onpointerup = canvas.onpointercancel = () => {
      grip = turn = frozen = null;
      endDrag();
      again();
    };
    canvas.ondblclick = () => {
      drawing.camera.reset();
      again();
    };
    const silence = tipOn(canvas, (x, y) => valueTip(latest.current, drawing.nearest(x, y, 14)));
    return () => {
      silence();
      close();
    };
  }, []);

  useLayoutEffect(
    () => redraw.current(),
    [own, selection.value, theme.value, coverOf(own), placesOf(own), shownMarks.value],
  );
  return (
    <div class="body">
      <div class="canvas fill" ref={host} aria-label={`Surface of ${own.name}, now and reference`} />
      <Readout own={own} />
    </div>
  );
}

/** What is known of a grid point that is under the mouse. */
export function valueTip(own: EditedTable, cell: number | null): string[] | null {
  if (cell === null) return null;
  const ny = size(own)[1];
  return [...cellTitle(own, cell).split("\n"), placeText(own.axes, [Math.floor(cell / ny), cell % ny])];
}

/** Make a grid point the active one; a selection that it is in stays. */
function select(own: EditedTable, cell: number): void {
  const ny = size(own)[1];
  const [i, j] = [Math.floor(cell / ny), cell % ny];
  const { x, y } = selection.value;
  const inside = i >= x[0] && i <= x[1] && j >= y[0] && j <= y[1];
  selection.value = inside ? { x, y, active: [i, j] } : { x: [i, i], y: [j, j], active: [i, j] };
}

function drag(own: EditedTable, { cell, value, y, perPixel, drag }: Grip, to: number): void {
  if (own.locked.includes(cell)) return;
  const moved = Number((value + (y - to) * perPixel).toPrecision(5));
  const bounded = Math.max(own.lower[cell] ?? -Infinity, Math.min(own.upper[cell] ?? Infinity, moved));
  const [i, j] = selection.value.active;
  setValues([cell], [bounded], `Dragged ${describeCells(own, { x: [i, i], y: [j, j], active: [i, j] })}`, drag);
}

function Readout({ own }: { own: EditedTable }) {
  const [i, j] = selection.value.active;
  const cell = cellAt(own, i, j);
  const [now, before] = [own.values[cell], own.reference[cell]];
  if (now === undefined || before === undefined) return null;
  return (
    <div class="tip readout" aria-live="off">
      <b class="ink">
        {significant(now)} {own.unit}
      </b>{" "}
      <span class="q">
        at {plain(own.axes[0]!.points[i]!, 4)}, {plain(own.axes[1]!.points[j]!, 4)}
      </span>
      <br />
      <span class="q">{referenceName.value}</span> {significant(before)} <span class="q">difference</span>{" "}
      {now === before ? "0" : signed(now - before)}
    </div>
  );
}
