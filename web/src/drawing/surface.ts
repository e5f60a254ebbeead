// A surface over two axes: values in colour, a reference as a grey ghost. Plain 2D canvas, far faces first.

import { extent, type Pen, type Range, ticks, ticksApart, tickTexts, widened } from "./canvas";
import { css, height as heightColour, isDark, type Rgb, token } from "./colours";
import { hatch, ring } from "./marks";
import { withUnit } from "./numbers";

export interface SurfaceAxis {
  title: string;
  unit: string;
  points: readonly number[];
}

/** A map in C order: `now[i * ny + j]` is at x[i], y[j]. */
export interface SurfaceMap {
  x: SurfaceAxis;
  y: SurfaceAxis;
  unit: string;
  now: ArrayLike<number>;
  reference: ArrayLike<number> | null;
  empty: ((cell: number) => boolean) | null; // grid points without data
  hidden?: "now" | "reference" | "both" | "";
  tints?: readonly (Rgb | null)[] | null; // colours of the values instead of those of their heights; null without data
}

export type Point = readonly [number, number, number]; // on the screen, and its depth

const ROOF = 0.62;
const TITLE = 36; // pixels from the floor to the title of an axis
const HOME = { azimuth: -0.62, elevation: 0.5 };

/** A perspective view of the box from -1 to 1 in x and y, and from -ROOF to ROOF in height. */
export class Camera {
  azimuth = HOME.azimuth;
  elevation = HOME.elevation;
  private scale = 1;
  private middle: [number, number] = [0, 0];
  private turn = [1, 0, 1, 0] as [number, number, number, number]; // cosine and sine of azimuth and elevation

  turnTo(azimuth: number, elevation: number): void {
    this.azimuth = azimuth;
    this.elevation = Math.max(0.02, Math.min(1.5, elevation));
  }

  reset(): void {
    this.turnTo(HOME.azimuth, HOME.elevation);
  }

  /** Fit the box into a picture, with room for the numbers around it and further margins at the left and the right. */
  fit(width: number, height: number, [marginLeft, marginRight]: Range = [0, 0]): void {
    this.turn = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    this.scale = 1;
    this.middle = [0, 0];
    const corners = [-1, 1].flatMap((a) => [-1, 1].flatMap((b) => [-ROOF, ROOF].map((c) => this.project(a, b, c))));
    const [left, right] = extent(corners.map((p) => p[0]));
    const [top, bottom] = extent(corners.map((p) => p[1]));
    this.scale = Math.max(
      10,
      Math.min((width - 110 - marginLeft - marginRight) / (right - left), (height - 72) / (bottom - top)),
    );
    this.middle = [
      (width + marginLeft - marginRight) / 2 - ((left + right) / 2) * this.scale + 8,
      height / 2 - ((top + bottom) / 2) * this.scale - 4,
    ];
  }

  project(x: number, y: number, z: number): Point {
    const [ca, sa, ce, se] = this.turn;
    const u = x * ca - y * sa;
    const v = x * sa + y * ca;
    const depth = v * ce - z * se;
    const q = this.scale / (1 + 0.13 * depth);
    return [this.middle[0] + u * q, this.middle[1] - (z * ce + v * se) * q, depth];
  }
}

// Corners of a face: (i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1). A face draws its far edges, which it shares with
// faces that are drawn before; those at the near rim draw all.
const ROUND = [0, 1, 2, 3, 0];
const FAR_EDGES = [
  [
    [3, 0, 1],
    [2, 3, 0],
  ],
  [
    [0, 1, 2],
    [1, 2, 3],
  ],
]; // by the signs of x and y of the back corner

interface Face {
  corners: readonly Point[];
  edges: readonly number[];
  ghost: boolean;
  mean: number;
  tint: Rgb | null;
  empty: boolean;
  tilt: number;
  depth: number;
}

export class Surface {
  readonly camera = new Camera();
  range: Range = [0, 1];
  points: Point[] = []; // of the values, by cell
  private map!: SurfaceMap;
  private xs: number[] = [];
  private ys: number[] = [];

  /** Draw a map; `range` keeps the height axis while a value is dragged. */
  draw(pen: Pen, width: number, height: number, map: SurfaceMap, range: Range | null = null): void {
    this.map = map;
    let margins: Range = [0, 0];
    for (let pass = 0; pass < 3; pass++) {
      this.camera.fit(width, height, margins);
      const [left, right] = this.overhang(pen, width);
      if (!left && !right) break;
      margins = [margins[0] + left, margins[1] + right];
    }
    this.xs = positions(map.x.points);
    this.ys = positions(map.y.points);
    this.range = range ?? heightRange(map);
    this.points = this.project(map.now);
    this.drawBox(pen);
    const paints = new Paints(this.range);
    for (const face of this.faces()) drawFace(pen, face, paints);
  }

  /**
   * Return the grid point that is drawn nearest to a pixel, null if none is near; of two at a place, the one in front.
   */
  nearest(x: number, y: number, reach: number): number | null {
    let [best, nearest]: [number, number | null] = [reach, null];
    this.points.forEach((p, cell) => {
      const distance = Math.hypot(p[0] - x, p[1] - y) + p[2];
      if (distance < best) [best, nearest] = [distance, cell];
    });
    return nearest;
  }

  /** Return how much a value changes for each pixel upwards. */
  perPixel(cell: number): number {
    const step = (this.range[1] - this.range[0]) / 200;
    const value = this.map.now[cell]!;
    return step / Math.max(0.005, this.at(cell, value)[1] - this.at(cell, value + step)[1]);
  }

  /** Draw the grip of a grid point: its foot, its reference, and that it moves up and down. */
  drawGrip(pen: Pen, cell: number): void {
    const [now, before] = [this.points[cell], this.map.reference?.[cell]];
    if (now === undefined) return;
    pen.strokeStyle = token("drag");
    pen.lineWidth = 1;
    pen.setLineDash([2, 3]);
    path(pen, [this.at(cell, this.range[0]), now]);
    pen.stroke();
    pen.setLineDash([]);
    if (before !== undefined && before !== this.map.now[cell]) {
      pen.lineWidth = 2;
      path(pen, [this.at(cell, before), now]);
      pen.stroke();
      ring(pen, this.at(cell, before), 3.5, token("paper"), token("before"), 1.5);
    }
    ring(pen, now, 6.5, token("drag"), token("paper"), 2);
    ring(pen, now, 9.5, "", token("drag"), 1);
    pen.lineWidth = 1.5;
    for (const side of [-1, 1]) {
      path(pen, [
        [now[0] - 3.5, now[1] + side * 14],
        [now[0], now[1] + side * 18],
        [now[0] + 3.5, now[1] + side * 14],
      ]);
      pen.stroke();
    }
  }

  /** Draw a dot at each place over the ground. */
  drawPlaces(pen: Pen, xs: ArrayLike<number>, ys: ArrayLike<number>, values: ArrayLike<number>, colour: string): void {
    pen.fillStyle = colour;
    for (let k = 0; k < values.length; k++) {
      const p = this.camera.project(
        position(this.map.x.points, xs[k]!),
        position(this.map.y.points, ys[k]!),
        this.heightOf(values[k]!),
      );
      pen.fillRect(p[0] - 0.9, p[1] - 0.9, 1.8, 1.8);
    }
  }

  private heightOf = (value: number): number =>
    ((value - this.range[0]) / (this.range[1] - this.range[0])) * 2 * ROOF - ROOF;

  private at(cell: number, value: number): Point {
    const ny = this.ys.length;
    return this.camera.project(this.xs[Math.floor(cell / ny)]!, this.ys[cell % ny]!, this.heightOf(value));
  }

  private project(values: ArrayLike<number>): Point[] {
    return this.xs.flatMap((x, i) =>
      this.ys.map((y, j) => this.camera.project(x, y, this.heightOf(values[i * this.ys.length + j]!))),
    );
  }

  private faces(): Face[] {
    const { now, reference, empty, hidden = "" } = this.map;
    const faces: Face[] = [];
    const shown = hidden !== "now" && hidden !== "both";
    const changed = reference !== null && this.points.some((_, k) => now[k] !== reference[k]);
    if (changed && hidden !== "reference" && hidden !== "both") {
      // the ghost of a face that is where it was would be hidden by it
      this.addFaces(
        faces,
        reference!,
        this.project(reference!),
        (cells) => shown && cells.every((cell) => now[cell] === reference![cell]),
        null,
      );
    }
    if (shown) this.addFaces(faces, now, this.points, () => false, empty);
    return faces.sort((p, q) => q.depth - p.depth);
  }

  private addFaces(
    faces: Face[],
    values: ArrayLike<number>,
    points: readonly Point[],
    skip: (cells: number[]) => boolean,
    empty: SurfaceMap["empty"],
  ): void {
    const ghost = values === this.map.reference;
    const [nx, ny, back] = [this.xs.length, this.ys.length, this.back()];
    const [nearX, nearY] = [back.x > 0 ? 0 : nx - 2, back.y > 0 ? 0 : ny - 2];
    const far = FAR_EDGES[back.x > 0 ? 1 : 0]![back.y > 0 ? 1 : 0]!;
    for (let i = 0; i + 1 < nx; i++) {
      for (let j = 0; j + 1 < ny; j++) {
        const cells = [i * ny + j, (i + 1) * ny + j, (i + 1) * ny + j + 1, i * ny + j + 1];
        const [a, b, c, d] = cells.map((cell) => values[cell]!) as [number, number, number, number];
        const mean = (a + b + c + d) / 4;
        if (!Number.isFinite(mean) || skip(cells)) continue;
        const corners = cells.map((cell) => points[cell]!);
        faces.push({
          corners,
          edges: i === nearX || j === nearY ? ROUND : far,
          ghost,
          mean,
          tint: ghost ? null : meanTint(cells, this.map.tints ?? null),
          empty: empty !== null && cells.some(empty),
          tilt: this.heightOf(b) - this.heightOf(a) + this.heightOf(c) - this.heightOf(d),
          depth: (corners[0]![2] + corners[1]![2] + corners[2]![2] + corners[3]![2]) / 4,
        });
      }
    }
  }

  /** Floor, back walls, and the numbers along the edges that face the viewer. */
  private drawBox(pen: Pen): void {
    const { x, y } = this.map;
    const back = this.back();
    const place = ({ points }: SurfaceAxis, value: number) => position(points, value);
    const marks = (axis: SurfaceAxis, corner: (at: number) => [number, number]) => {
      const placeOf = (value: number) => {
        const [left, top] = this.camera.project(...corner(place(axis, value)), -ROOF);
        return [left, top] as const;
      };
      const { points } = axis;
      return ticksApart(points[0]!, points[points.length - 1]!, 5, placeOf, (text) => pen.measureText(text).width);
    };
    const [xs, ys] = [marks(x, (at) => [at, -back.y]), marks(y, (at) => [-back.x, at])];
    const zs = ticks(...this.range, 4);
    pen.lineWidth = 1;
    pen.strokeStyle = token("grid");
    for (const v of xs)
      this.stroke(pen, [place(x, v), -back.y, -ROOF], [place(x, v), back.y, -ROOF], [place(x, v), back.y, ROOF]);
    for (const v of ys)
      this.stroke(pen, [-back.x, place(y, v), -ROOF], [back.x, place(y, v), -ROOF], [back.x, place(y, v), ROOF]);
    for (const v of zs)
      this.stroke(
        pen,
        [-back.x, back.y, this.heightOf(v)],
        [back.x, back.y, this.heightOf(v)],
        [back.x, -back.y, this.heightOf(v)],
      );
    pen.strokeStyle = token("axis");
    this.stroke(pen, [-back.x, -back.y, -ROOF], [back.x, -back.y, -ROOF]);
    this.stroke(pen, [-back.x, -back.y, -ROOF], [-back.x, back.y, -ROOF]);
    this.stroke(pen, [...back.side, -ROOF], [...back.side, ROOF]);
    pen.fillStyle = token("quiet");
    pen.textBaseline = "middle";
    tickTexts(xs).forEach((text, k) =>
      this.write(pen, text, [place(x, xs[k]!), -back.y], [place(x, xs[k]!), back.y], 13),
    );
    tickTexts(ys).forEach((text, k) =>
      this.write(pen, text, [-back.x, place(y, ys[k]!)], [back.x, place(y, ys[k]!)], 14),
    );
    for (const { text, at, from } of this.titles()) this.write(pen, text, at, from, TITLE, true);
    this.writeHeights(pen, zs, back.side);
  }

  private titles(): { text: string; at: [number, number]; from: [number, number] }[] {
    const { x, y } = this.map;
    const back = this.back();
    return [
      { text: withUnit(x.title, x.unit), at: [0, -back.y], from: [0, back.y] },
      { text: withUnit(y.title, y.unit), at: [-back.x, 0.1], from: [back.x, 0.1] },
    ];
  }

  /** How far the titles would reach beyond the picture at its left and its right. */
  private overhang(pen: Pen, width: number): Range {
    let [left, right] = [0, 0];
    for (const { text, at, from } of this.titles()) {
      const { x, aside } = this.outwards(at, from, TITLE);
      const wide = pen.measureText(text).width;
      const start = Math.abs(aside) < 0.25 ? x - wide / 2 : aside > 0 ? x : x - wide;
      left = Math.max(left, 2 - start);
      right = Math.max(right, start + wide + 2 - width);
    }
    return [left, right];
  }

  /** A place outside an edge of the floor, and how far sideways it lies. */
  private outwards(
    at: [number, number],
    from: [number, number],
    distance: number,
  ): { x: number; y: number; aside: number } {
    const [a, b] = [this.camera.project(...at, -ROOF), this.camera.project(...from, -ROOF)];
    const length = Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
    const aside = (a[0] - b[0]) / length;
    return { x: a[0] + aside * distance, y: a[1] + ((a[1] - b[1]) / length) * distance, aside };
  }

  /** The signs of x and y of the back corner, and the upright edge at the left of the picture. */
  private back(): { x: number; y: number; side: [number, number] } {
    const depth = (x: number, y: number) => this.camera.project(x, y, -ROOF)[2];
    const [x, y] = [depth(1, 0) > depth(-1, 0) ? 1 : -1, depth(0, 1) > depth(0, -1) ? 1 : -1];
    const left = this.camera.project(-x, y, -ROOF)[0] < this.camera.project(x, -y, -ROOF)[0];
    return { x, y, side: left ? [-x, y] : [x, -y] };
  }

  private stroke(pen: Pen, ...points: [number, number, number][]): void {
    path(
      pen,
      points.map((p) => this.camera.project(...p)),
    );
    pen.stroke();
  }

  /** Write outwards from an edge of the floor; a title starts beside what is written there, instead of astride it. */
  private write(
    pen: Pen,
    text: string,
    at: [number, number],
    from: [number, number],
    distance: number,
    title = false,
  ): void {
    const { x, y, aside } = this.outwards(at, from, distance);
    pen.textAlign = !title || Math.abs(aside) < 0.25 ? "center" : aside > 0 ? "left" : "right";
    pen.fillText(text, x, y);
  }

  private writeHeights(pen: Pen, values: number[], side: [number, number]): void {
    pen.textAlign = "right";
    tickTexts(values).forEach((text, k) => {
      const p = this.camera.project(...side, this.heightOf(values[k]!));
      pen.fillText(text, p[0] - 6, p[1]);
    });
    const top = this.camera.project(...side, ROOF);
    if (this.map.unit !== "-") pen.fillText(this.map.unit, top[0] - 4, top[1] - 13);
    pen.textBaseline = "alphabetic";
    pen.textAlign = "left";
  }
}

/** The mean of the colours at the corners of a face that have data; the colour of paper if none has. */
function meanTint(cells: readonly number[], tints: readonly (Rgb | null)[] | null): Rgb | null {
  if (tints === null) return null;
  const known = cells.map((cell) => tints[cell]).filter((tint): tint is Rgb => tint != null);
  const paper: Rgb = isDark() ? [23, 26, 31] : [255, 255, 255];
  return known.length
    ? ([0, 1, 2].map((k) => known.reduce((sum, tint) => sum + tint[k]!, 0) / known.length) as unknown as Rgb)
    : paper;
}

/** The colours of one picture, looked up once. */
class Paints {
  private readonly dark = isDark();
  private readonly paper = this.dark ? 23 : 255;
  readonly ghost = this.dark
    ? { fill: "rgba(150,158,168,.10)", stroke: "rgba(170,178,188,.75)" }
    : { fill: "rgba(150,156,163,.13)", stroke: "rgba(105,111,118,.8)" };
  readonly edge = this.dark ? "rgba(10,14,18,.75)" : "rgba(20,30,45,.55)";

  constructor(private readonly range: Range) {}

  of(face: Face): string {
    const light = (1 + 0.12 * Math.tanh(face.tilt)) * (this.dark ? 0.86 : 1);
    const share = (face.mean - this.range[0]) / (this.range[1] - this.range[0]);
    const lit = (face.tint ?? heightColour(share)).map((part) => Math.min(255, part * light));
    const shown = face.empty ? lit.map((part) => part + (this.paper - part) * 0.5) : lit;
    return css(shown.map(Math.round) as unknown as Rgb, 0.94);
  }
}

function drawFace(pen: Pen, face: Face, paints: Paints): void {
  path(pen, face.corners, ROUND);
  pen.lineWidth = 0.7;
  pen.fillStyle = face.ghost ? paints.ghost.fill : paints.of(face);
  pen.strokeStyle = face.ghost ? paints.ghost.stroke : paints.edge;
  pen.fill();
  if (face.empty) hatch(pen);
  path(pen, face.corners, face.edges);
  pen.stroke();
}

/** Begin a path through points, or through some of them in an order. */
function path(pen: Pen, points: readonly (readonly number[])[], order?: readonly number[]): void {
  pen.beginPath();
  for (let k = 0; k < (order ?? points).length; k++) {
    const point = points[order ? order[k]! : k]!;
    if (k) pen.lineTo(point[0]!, point[1]!);
    else pen.moveTo(point[0]!, point[1]!);
  }
}

function position(points: readonly number[], value: number): number {
  const first = points[0]!;
  return ((value - first) / (points[points.length - 1]! - first || 1)) * 2 - 1;
}

const positions = (points: readonly number[]): number[] => points.map((value) => position(points, value));

/** The range of what is shown. */
function heightRange({ now, reference, hidden = "" }: SurfaceMap): Range {
  const shown = [hidden === "now" ? [] : now, reference === null || hidden === "reference" ? [] : reference];
  return widened(hidden === "both" ? extent(now) : extent(...shown), 0);
}
