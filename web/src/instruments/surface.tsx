// A surface over two axes: values now in colour, the reference as a grey ghost. Drag the dot, or turn the ground.

import { useEffect, useRef } from "preact/hooks";
import { canvasIn, extent, hatch, ticks, decimals, widened, type Pen } from "../drawing/canvas";
import { css, height as heightColour, isDark, token } from "../drawing/colours";
import { fixed } from "../drawing/numbers";
import { endDrag, selection, setValues, theme, type Table } from "../store";
import { cellAt, size } from "./map-table";
import { describeCells } from "./table-edits";

type Point = readonly [number, number, number]; // on the screen, and its depth

const ROOF = 0.62;
const HOME = { azimuth: -0.62, elevation: 0.5 };

class Camera {
  azimuth = HOME.azimuth;
  elevation = HOME.elevation;
  private scale = 1;
  private middle: [number, number] = [0, 0];

  fit(width: number, height: number): void {
    this.scale = 1;
    this.middle = [0, 0];
    const corners = [-1, 1].flatMap((a) => [-1, 1].flatMap((b) => [-ROOF, ROOF].map((c) => this.project(a, b, c))));
    const [left, right] = extent(corners.map((p) => p[0]));
    const [top, bottom] = extent(corners.map((p) => p[1]));
    this.scale = Math.max(10, Math.min((width - 110) / (right - left), (height - 72) / (bottom - top)));
    this.middle = [width / 2 - ((left + right) / 2) * this.scale + 8, height / 2 - ((top + bottom) / 2) * this.scale - 4];
  }

  project(x: number, y: number, z: number): Point {
    const { azimuth: a, elevation: e } = this;
    const u = x * Math.cos(a) - y * Math.sin(a);
    const v = x * Math.sin(a) + y * Math.cos(a);
    const depth = v * Math.cos(e) - z * Math.sin(e);
    const q = this.scale / (1 + 0.13 * depth);
    return [this.middle[0] + u * q, this.middle[1] - (z * Math.cos(e) + v * Math.sin(e)) * q, depth];
  }

  /** Pixels upwards that a unit of height takes at a place. */
  lift(x: number, y: number, z: number): number {
    return this.project(x, y, z)[1] - this.project(x, y, z + 0.01)[1];
  }
}

interface Face { corners: Point[]; ghost: boolean; mean: number; empty: boolean; tilt: number; depth: number }

class Scene {
  readonly camera = new Camera();
  own: Table | null = null;
  points: Point[] = [];
  range: readonly [number, number] = [0, 1];

  heightOf = (value: number): number => ((value - this.range[0]) / (this.range[1] - this.range[0])) * 2 * ROOF - ROOF;

  place(axis: number, value: number): number {
    const points = this.own!.axes[axis]!.points;
    const span = points[points.length - 1]! - points[0]! || 1;
    return ((value - points[0]!) / span) * 2 - 1;
  }

  draw(pen: Pen, width: number, height: number, frozen: readonly [number, number] | null): void {
    const own = this.own;
    if (own === null || own.axes.length !== 2) return;
    this.camera.fit(width, height);
    this.range = frozen ?? widened(extent(own.values, own.reference), 0);
    this.box(pen, own);
    for (const face of this.faces(own)) this.face(pen, face);
    this.points = own.values.map((value, k) => this.at(own, k, value));
    this.dot(pen, own);
  }

  at(own: Table, cell: number, value: number): Point {
    const ny = size(own)[1];
    const x = own.axes[0]!.points[Math.floor(cell / ny)]!;
    const y = own.axes[1]!.points[cell % ny]!;
    return this.camera.project(this.place(0, x), this.place(1, y), this.heightOf(value));
  }

  private faces(own: Table): Face[] {
    const [nx, ny] = size(own);
    const faces: Face[] = [];
    const changed = own.values.some((value, k) => value !== own.reference[k]);
    for (const [values, ghost] of [[own.reference, true], [own.values, false]] as const) {
      if (ghost && !changed) continue;
      for (let i = 0; i + 1 < nx; i++) {
        for (let j = 0; j + 1 < ny; j++) {
          const cells = [cellAt(own, i, j), cellAt(own, i + 1, j), cellAt(own, i + 1, j + 1), cellAt(own, i, j + 1)];
          const z = cells.map((cell) => values[cell]!);
          const corners = cells.map((cell, k) => this.at(own, cell, z[k]!));
          const [a, b, c, d] = z.map(this.heightOf) as [number, number, number, number];
          faces.push({
            corners, ghost, mean: z.reduce((sum, value) => sum + value, 0) / 4, tilt: b - a + c - d,
            empty: !ghost && own.samples !== null && cells.some((cell) => own.samples![cell] === 0),
            depth: corners.reduce((sum, p) => sum + p[2], 0) / 4,
          });
        }
      }
    }
    return faces.sort((p, q) => q.depth - p.depth);
  }

  private face(pen: Pen, face: Face): void {
    const path = () => {
      pen.beginPath();
      face.corners.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"](x, y));
      pen.closePath();
    };
    path();
    pen.lineWidth = 0.7;
    if (face.ghost) {
      pen.fillStyle = isDark() ? "rgba(150,158,168,.10)" : "rgba(150,156,163,.13)";
      pen.strokeStyle = isDark() ? "rgba(170,178,188,.55)" : "rgba(105,111,118,.62)";
      pen.fill();
      pen.stroke();
      return;
    }
    const light = (1 + 0.12 * Math.tanh(face.tilt)) * (isDark() ? 0.86 : 1);
    const colour = heightColour((face.mean - this.range[0]) / (this.range[1] - this.range[0])).map((part) => Math.round(Math.min(255, part * light)));
    const paper = isDark() ? 23 : 255;
    const faded = face.empty ? colour.map((part) => Math.round(part + (paper - part) * 0.5)) : colour;
    pen.fillStyle = css(faded as unknown as [number, number, number], 0.94);
    pen.fill();
    if (face.empty) {
      hatch(pen, face.corners.map(([x, y]) => [x, y] as const));
      path();
    }
    pen.strokeStyle = isDark() ? "rgba(10,14,18,.55)" : "rgba(20,30,45,.36)";
    pen.lineWidth = 0.7;
    pen.stroke();
  }

  /** Floor, back walls, and the numbers along the edges that face the viewer. */
  private box(pen: Pen, own: Table): void {
    const P = (x: number, y: number, z: number) => this.camera.project(x, y, z);
    const backX = P(1, 0, -ROOF)[2] > P(-1, 0, -ROOF)[2] ? 1 : -1;
    const backY = P(0, 1, -ROOF)[2] > P(0, -1, -ROOF)[2] ? 1 : -1;
    const draw = (...points: [number, number, number][]) => {
      pen.beginPath();
      points.forEach((p, k) => { const q = P(...p); pen[k ? "lineTo" : "moveTo"](q[0], q[1]); });
      pen.stroke();
    };
    const marks = (axis: number) => {
      const points = own.axes[axis]!.points;
      return ticks(points[0]!, points[points.length - 1]!, 5);
    };
    const [xs, ys, zs] = [marks(0), marks(1), ticks(this.range[0], this.range[1], 4)];
    pen.strokeStyle = token("grid");
    pen.lineWidth = 1;
    for (const v of xs) draw([this.place(0, v), -backY, -ROOF], [this.place(0, v), backY, -ROOF], [this.place(0, v), backY, ROOF]);
    for (const v of ys) draw([-backX, this.place(1, v), -ROOF], [backX, this.place(1, v), -ROOF], [backX, this.place(1, v), ROOF]);
    for (const v of zs) draw([-backX, backY, this.heightOf(v)], [backX, backY, this.heightOf(v)], [backX, -backY, this.heightOf(v)]);
    pen.strokeStyle = token("axis");
    draw([-backX, -backY, -ROOF], [backX, -backY, -ROOF]);
    draw([-backX, -backY, -ROOF], [-backX, backY, -ROOF]);
    const side: [number, number] = P(-backX, backY, -ROOF)[0] < P(backX, -backY, -ROOF)[0] ? [-backX, backY] : [backX, -backY];
    draw([...side, -ROOF], [...side, ROOF]);
    pen.fillStyle = token("quiet");
    pen.textBaseline = "middle";
    const write = (text: string, at: [number, number], from: [number, number], far: number) => {
      const [a, b] = [P(...at, -ROOF), P(...from, -ROOF)];
      const length = Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
      pen.textAlign = "center";
      pen.fillText(text, a[0] + ((a[0] - b[0]) / length) * far, a[1] + ((a[1] - b[1]) / length) * far);
    };
    for (const v of xs) write(fixed(v, decimals(xs)), [this.place(0, v), -backY], [this.place(0, v), backY], 13);
    for (const v of ys) write(fixed(v, decimals(ys)), [-backX, this.place(1, v)], [backX, this.place(1, v)], 14);
    write(title(own, 0), [0, -backY], [0, backY], 42);
    write(title(own, 1), [-backX, 0.1], [backX, 0.1], 46);
    pen.textAlign = "right";
    for (const v of zs) {
      const p = P(...side, this.heightOf(v));
      pen.fillText(fixed(v, decimals(zs)), p[0] - 6, p[1]);
    }
    const top = P(...side, ROOF);
    pen.fillText(own.unit, top[0] - 4, top[1] - 13);
    pen.textBaseline = "alphabetic";
    pen.textAlign = "left";
  }

  private dot(pen: Pen, own: Table): void {
    const [i, j] = selection.value.active;
    const cell = cellAt(own, i, j);
    const now = this.points[cell];
    if (now === undefined) return;
    const before = this.at(own, cell, own.reference[cell]!);
    const foot = this.at(own, cell, this.range[0]);
    pen.strokeStyle = token("drag");
    pen.lineWidth = 1;
    pen.setLineDash([2, 3]);
    pen.beginPath();
    pen.moveTo(foot[0], foot[1]);
    pen.lineTo(now[0], now[1]);
    pen.stroke();
    pen.setLineDash([]);
    if (own.values[cell] !== own.reference[cell]) {
      pen.lineWidth = 2;
      pen.beginPath();
      pen.moveTo(before[0], before[1]);
      pen.lineTo(now[0], now[1]);
      pen.stroke();
      ring(pen, before, 3.5, token("paper"), token("before"), 1.5);
    }
    ring(pen, now, 6.5, token("drag"), token("paper"), 2);
    ring(pen, now, 9.5, "", token("drag"), 1);
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (const s of [-1, 1]) {
      pen.moveTo(now[0] - 3.5, now[1] + s * 14);
      pen.lineTo(now[0], now[1] + s * 18);
      pen.lineTo(now[0] + 3.5, now[1] + s * 14);
    }
    pen.stroke();
  }
}

function ring(pen: Pen, [x, y]: Point, radius: number, fill: string, stroke: string, width: number): void {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  if (fill) {
    pen.fillStyle = fill;
    pen.fill();
  }
  pen.strokeStyle = stroke;
  pen.lineWidth = width;
  pen.stroke();
}

function title(own: Table, axis: number): string {
  const { input, unit } = own.axes[axis]!;
  return unit && unit !== "-" ? `${input} [${unit}]` : input;
}

export function Surface({ own }: { own: Table }) {
  const host = useRef<HTMLDivElement>(null);
  const scene = useRef(new Scene());
  const redraw = useRef<() => void>(() => {});
  scene.current.own = own;

  useEffect(() => {
    const current = scene.current;
    let frozen: readonly [number, number] | null = null; // the height axis stays while a dot is dragged
    const { canvas, redraw: again, close } = canvasIn(host.current!, (pen, width, height) => current.draw(pen, width, height, frozen));
    redraw.current = again;
    let grip: { value: number; y: number; drag: string } | null = null;
    let turn: { x: number; y: number; azimuth: number; elevation: number } | null = null;
    const nearest = (event: PointerEvent): number | null => {
      const box = canvas.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      let [best, cell]: [number, number | null] = [14, null];
      current.points.forEach((p, k) => {
        const distance = Math.hypot(p[0] - x, p[1] - y) + p[2];
        if (distance < best) [best, cell] = [distance, k];
      });
      return cell;
    };
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      const cell = nearest(event);
      const table = current.own!;
      if (cell === null) {
        turn = { x: event.clientX, y: event.clientY, azimuth: current.camera.azimuth, elevation: current.camera.elevation };
        return;
      }
      const ny = size(table)[1];
      const [i, j] = [Math.floor(cell / ny), cell % ny];
      const { x, y } = selection.value;
      const inside = i >= x[0] && i <= x[1] && j >= y[0] && j <= y[1];
      selection.value = inside ? { x, y, active: [i, j] } : { x: [i, i], y: [j, j], active: [i, j] };
      frozen = current.range;
      grip = { value: table.values[cell]!, y: event.clientY, drag: `${table.name} ${event.timeStamp}` };
    };
    canvas.onpointermove = (event) => {
      if (turn !== null) {
        current.camera.azimuth = turn.azimuth + (event.clientX - turn.x) * 0.009;
        current.camera.elevation = Math.max(0.05, Math.min(1.5, turn.elevation + (event.clientY - turn.y) * 0.007));
        again();
      } else if (grip !== null) {
        const table = current.own!;
        const [i, j] = selection.value.active;
        const cell = cellAt(table, i, j);
        if (table.locked.includes(cell)) return;
        const [x, y] = [current.place(0, table.axes[0]!.points[i]!), current.place(1, table.axes[1]!.points[j]!)];
        const pixels = current.camera.lift(x, y, current.heightOf(table.values[cell]!)) / 0.01;
        const perPixel = (current.range[1] - current.range[0]) / (2 * ROOF) / Math.max(pixels, 1);
        const value = Number((grip.value + (grip.y - event.clientY) * perPixel).toPrecision(5));
        const lowest = table.lower[cell] ?? -Infinity;
        const highest = table.upper[cell] ?? Infinity;
        const chosen = { ...selection.value, x: [i, i] as [number, number], y: [j, j] as [number, number] };
        setValues([cell], [Math.max(lowest, Math.min(highest, value))], `Dragged ${describeCells(table, chosen)}`, grip.drag);
      } else canvas.style.cursor = nearest(event) === null ? "grab" : "ns-resize";
    };
    canvas.onpointerup = () => {
      grip = turn = frozen = null;
      endDrag();
      again();
    };
    canvas.ondblclick = () => {
      Object.assign(current.camera, HOME);
      again();
    };
    return close;
  }, []);

  useEffect(() => redraw.current(), [own, selection.value, theme.value]);
  return <div class="body canvas" ref={host} aria-label={`Surface of ${own.name}, now and reference`} />;
}
