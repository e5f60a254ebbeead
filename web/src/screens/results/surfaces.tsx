// A table in two sets: two surfaces on one scale that turn together, or two curves in one plot, and the difference.

import { useLayoutEffect, useRef } from "preact/hooks";
import { first, nameOfSet, second } from "../../comparison";
import { type Area, area, canvasIn, extent, line, type Pen, type Range, widened } from "../../drawing/canvas";
import { css, diverging, token } from "../../drawing/colours";
import { cellIn, drawCells } from "../../drawing/grid";
import { dots } from "../../drawing/marks";
import { MISSING, plain, signed, significant, unitText, withUnit } from "../../drawing/numbers";
import { Camera, Surface, type SurfaceMap } from "../../drawing/surface";
import { nearestTo, type Read, tipOn } from "../../hover-tip";
import { Picture } from "../../instruments/picture";
import { placeText } from "../../instruments/pictures";
import type { AxisPoints, ComparedTable } from "../../replies";
import { theme } from "../../store";

interface Shown {
  own: ComparedTable;
  taken: ReadonlySet<number>;
  pick: (cell: number) => void;
}

export function Surfaces({ own, taken, pick }: Shown) {
  const camera = useRef(new Camera());
  const views = useRef<(() => void)[]>([]);
  const turned = (): void => {
    for (const redraw of views.current) redraw();
  };
  const range = widened(extent(own.first, own.second), 0); // equal values have a height, too
  const difference = own.second.map((value, k) => value - own.first[k]!);
  if (own.axes.length === 2)
    return (
      <div class="maps">
        <Cell badge="a" set={first.value} own={own} values={own.first} />
        <Cell badge="b" set={second.value} own={own} values={own.second} ghost />
        <Head
          title="B − A"
          sub={taken.size < own.first.length ? "outlined: to take" : ""}
          values={difference}
          unit={own.unit}
        />
        <Turning own={own} side="first" {...{ range, camera: camera.current, views: views.current, turned, pick }} />
        <Turning own={own} side="second" {...{ range, camera: camera.current, views: views.current, turned, pick }} />
        <Picture
          label={`Difference of ${own.name}`}
          draw={(pen, width, height) => drawDifference(pen, width, height, own, difference, taken)}
          of={[own, taken]}
        />
      </div>
    );
  if (own.axes.length === 1)
    return (
      <div class="maps one">
        <Cell badge="a" set={first.value} own={own} values={own.first} />
        <Cell badge="b" set={second.value} own={own} values={own.second} />
        <Picture
          label={`${own.name} in both sets`}
          draw={(pen, width, height) => drawBoth(pen, width, height, own, difference)}
          of={[own]}
        />
      </div>
    );
  return (
    <div class="maps one">
      <Cell badge="a" set={first.value} own={own} values={own.first} />
      <Cell badge="b" set={second.value} own={own} values={own.second} />
      <p class="pad q">
        {own.axes.length === 0
          ? `Difference ${signed(difference[0] ?? 0, 4)} ${own.unit === "-" ? "" : own.unit}`
          : `A table over ${own.axes.length} axes: its values are listed below.`}
      </p>
    </div>
  );
}

function Cell(props: { badge: "a" | "b"; set: string; own: ComparedTable; values: number[]; ghost?: boolean }) {
  return (
    <Head
      badge={props.badge}
      title={nameOfSet(props.set)}
      sub={props.ghost ? "ghost: A" : props.own.name}
      values={props.values}
      unit={props.own.unit}
    />
  );
}

function Head(props: { badge?: "a" | "b"; title: string; sub: string; values: number[]; unit: string }) {
  const [low, high] = extent(props.values);
  const range = low === high ? significant(low) : `${significant(low)} … ${significant(high)}`;
  return (
    <div class="cp">
      {props.badge && <span class={`ab ${props.badge} on`}>{props.badge.toUpperCase()}</span>}
      <b class="cut">{props.title}</b>
      <span class="q cut">{props.sub}</span>
      <span class="q end">
        {props.values.length ? range : MISSING} {props.unit === "-" ? "" : props.unit}
      </span>
    </div>
  );
}

interface TurningProps {
  own: ComparedTable;
  side: "first" | "second";
  range: Range;
  camera: Camera;
  views: (() => void)[];
  turned: () => void;
  pick: (cell: number) => void;
}

function Turning({ own, side, range, camera, views, turned, pick }: TurningProps) {
  const host = useRef<HTMLDivElement>(null);
  const latest = useRef({ own, range, pick });
  latest.current = { own, range, pick };
  const redraw = useRef<() => void>(() => {});
  useLayoutEffect(() => {
    const drawing = new Surface();
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, width, height) => {
      drawing.camera.turnTo(camera.azimuth, camera.elevation);
      drawing.draw(pen, width, height, mapOf(latest.current.own, side, width > 250), latest.current.range);
    });
    redraw.current = again;
    views.push(again);
    let turn: { x: number; y: number; azimuth: number; elevation: number } | null = null;
    let moved = false;
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      turn = { x: event.clientX, y: event.clientY, azimuth: camera.azimuth, elevation: camera.elevation };
      moved = false;
    };
    canvas.onpointermove = (event) => {
      if (turn === null) return;
      moved ||= Math.hypot(event.clientX - turn.x, event.clientY - turn.y) > 3;
      camera.turnTo(turn.azimuth + (event.clientX - turn.x) * 0.009, turn.elevation + (event.clientY - turn.y) * 0.007);
      turned();
    };
    canvas.onpointerup = (event) => {
      const cell = moved ? null : drawing.nearest(event.offsetX, event.offsetY, 14);
      if (cell !== null) latest.current.pick(cell);
      turn = null;
    };
    canvas.onpointercancel = () => {
      turn = null;
    };
    canvas.ondblclick = () => {
      camera.reset();
      turned();
    };
    const silence = tipOn(canvas, (x, y) => bothTip(latest.current.own, drawing.nearest(x, y, 14)));
    return () => {
      silence();
      views.splice(views.indexOf(again), 1);
      close();
    };
  }, []);
  useLayoutEffect(() => redraw.current(), [own, range[0], range[1], theme.value]);
  return <div class="canvas turning" ref={host} aria-label={`${own.name}, ${side === "first" ? "A" : "B"}`} />;
}

/** Both values of a grid point, and their difference. */
function bothTip(own: ComparedTable, cell: number | null): string[] | null {
  if (cell === null) return null;
  const [a, b] = [own.first[cell]!, own.second[cell]!];
  const ny = own.axes[1]?.points.length;
  return [
    `${a === b ? "0" : signed(b - a)} ${unitText(own.unit)}`,
    `A ${nameOfSet(first.value)} ${significant(a)}`,
    `B ${nameOfSet(second.value)} ${significant(b)}`,
    placeText(own.axes, ny === undefined ? [cell] : [Math.floor(cell / ny), cell % ny]),
  ];
}

/** A table as a surface; a narrow picture has no room for the names of the axes, which the difference beside it has. */
function mapOf(own: ComparedTable, side: "first" | "second", named: boolean): SurfaceMap {
  const axis = ({ input, unit, points }: AxisPoints) => ({
    title: named ? input : "",
    unit: named ? unit : "",
    points,
  });
  return {
    x: axis(own.axes[0]!),
    y: axis(own.axes[1]!),
    unit: own.unit,
    now: own[side],
    reference: side === "second" ? own.first : own.second,
    empty: null,
  };
}

/** The difference as coloured cells with the names and ends of the axes; what is to be taken is outlined. */
function drawDifference(
  pen: Pen,
  width: number,
  height: number,
  own: ComparedTable,
  values: number[],
  taken: ReadonlySet<number>,
): Read {
  const [x, y] = own.axes as [AxisPoints, AxisPoints];
  const [nx, ny] = [x.points.length, y.points.length];
  const box = { left: 62, right: width - 14, top: 6, bottom: height - 56 };
  // without any change, the scale is that of a change of one unit
  const reach = Math.max(0, ...values.filter(Number.isFinite).map(Math.abs)) || 1;
  const edges = drawCells(pen, box, nx, ny, (i, j) => {
    const value = values[i * ny + j]!;
    return Number.isFinite(value) ? css(diverging(value / reach)) : null;
  });
  const isTaken = (i: number, j: number): boolean =>
    i >= 0 && j >= 0 && i < nx && j < ny && taken.has(i * ny + j) && taken.size < values.length;
  pen.strokeStyle = token("ink");
  pen.lineWidth = 1.5;
  pen.beginPath();
  for (let i = 0; i < nx; i++)
    for (let j = 0; j < ny; j++) {
      if (!isTaken(i, j)) continue;
      const { left, right, top, bottom } = edges(i, j);
      const sides: [boolean, number, number, number, number][] = [
        [isTaken(i - 1, j), left, top, left, bottom],
        [isTaken(i + 1, j), right, top, right, bottom],
        [isTaken(i, j + 1), left, top, right, top],
        [isTaken(i, j - 1), left, bottom, right, bottom],
      ];
      for (const [inner, x0, y0, x1, y1] of sides) {
        if (inner) continue;
        pen.moveTo(x0, y0);
        pen.lineTo(x1, y1);
      }
    }
  pen.stroke();
  labelAxes(pen, box, x, y, edges);
  drawKey(pen, box, reach, own.unit);
  return (atX, atY) => {
    const cell = cellIn(box, nx, ny, atX, atY);
    return cell === null ? null : bothTip(own, cell[0] * ny + cell[1]);
  };
}

function labelAxes(
  pen: Pen,
  box: Area["box"],
  x: AxisPoints,
  y: AxisPoints,
  edges: (i: number, j: number) => Area["box"],
): void {
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  const everyY = Math.max(1, Math.ceil(y.points.length / ((box.bottom - box.top) / 16)));
  for (let j = 0; j < y.points.length; j += everyY) {
    const { top, bottom } = edges(0, j);
    pen.fillText(plain(y.points[j]!, 5), box.left - 5, (top + bottom) / 2);
  }
  pen.textBaseline = "top";
  pen.textAlign = "center";
  const everyX = Math.max(1, Math.ceil(x.points.length / ((box.right - box.left) / 46)));
  for (let i = 0; i < x.points.length; i += everyX) {
    const { left, right } = edges(i, 0);
    pen.fillText(plain(x.points[i]!, 5), (left + right) / 2, box.bottom + 4);
  }
  pen.textAlign = "right";
  pen.fillText(withUnit(x.input, x.unit), box.right, box.bottom + 18);
  pen.save();
  pen.translate(10, (box.top + box.bottom) / 2);
  pen.rotate(-Math.PI / 2);
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(withUnit(y.input, y.unit), 0, 0);
  pen.restore();
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
}

/** The scale of the difference below a picture. */
function drawKey(pen: Pen, { left, right, bottom }: Area["box"], reach: number, unit: string): void {
  const top = bottom + 34;
  const steps = 60;
  for (let k = 0; k < steps; k++) {
    pen.fillStyle = css(diverging((2 * (k + 0.5)) / steps - 1));
    pen.fillRect(left + ((right - left) * k) / steps, top, (right - left) / steps + 0.6, 4);
  }
  pen.fillStyle = token("quiet");
  pen.textBaseline = "top";
  pen.textAlign = "left";
  pen.fillText(signed(-reach), left, top + 6);
  pen.textAlign = "right";
  pen.fillText(signed(reach), right, top + 6);
  pen.textAlign = "center";
  if (unit !== "-") pen.fillText(unit, (left + right) / 2, top + 6);
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
}

/** Both curves in one plot, and their difference below. */
function drawBoth(pen: Pen, width: number, height: number, own: ComparedTable, difference: number[]): Read {
  const { points, input, unit } = own.axes[0]!;
  const middle = Math.round(height * 0.64);
  const range = widened(extent(points), 0);
  const upper = area(
    pen,
    { left: 62, right: width - 14, top: 8, bottom: middle - 6 },
    range,
    widened(extent(own.first, own.second), 0.08),
    { unlabelled: true, yTitle: own.unit === "-" ? "" : own.unit },
  );
  const xs = points.map(upper.x);
  upper.clip(() => {
    line(pen, xs, own.first.map(upper.y), token("before"), 1.5);
    line(pen, xs, own.second.map(upper.y), token("model"), 1.5);
  });
  dots(pen, xs, own.second.map(upper.y), token("model"), 2.4);
  const lower = area(
    pen,
    { left: 62, right: width - 14, top: middle + 4, bottom: height - 34 },
    range,
    widened(extent(difference, [0]), 0.1),
    { title: withUnit(input, unit), yTitle: "B − A" },
  );
  lower.clip(() => line(pen, xs, difference.map(lower.y), token("error"), 1.5));
  return (x) => bothTip(own, nearestTo(points, upper.xAt(x)));
}
