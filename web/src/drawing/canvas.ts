// Canvases that follow the size of their host, and plot areas with grid, ticks and titles.

import { token } from "./colours";
import { count, fixed, plain } from "./numbers";

export type Pen = CanvasRenderingContext2D;
export type Range = readonly [number, number];

const canvases = new Set<() => void>();

/** How a canvas is drawn, its size, and its number: those with higher ones lie over the others. */
export interface Drawn {
  draw: (pen: Pen, width: number, height: number) => void;
  width: number;
  height: number;
  number: number;
}

const drawings = new WeakMap<HTMLCanvasElement, () => Drawn>();
let last = 0;

/** How a canvas of `canvasIn` is drawn, to draw it elsewhere; null for another one. */
export const drawnIn = (canvas: HTMLCanvasElement): Drawn | null => drawings.get(canvas)?.() ?? null;
const waiting = new Set<() => void>();

/** Draw all waiting canvases in the next frame. */
function requestDrawing(draw: () => void): void {
  if (!waiting.size) requestAnimationFrame(drawWaiting);
  waiting.add(draw);
}

function drawWaiting(): void {
  const draws = [...waiting];
  waiting.clear();
  for (const draw of draws) draw();
}

/** Draw every canvas of the page at once, as a new theme or printing needs it. */
export function redrawAll(): void {
  for (const draw of canvases) draw();
}

/**
 * Draw into a host whenever it changes its size; returns a function that draws again, at most once a frame.
 *
 * The canvas fills its host. With `tall`, it stands in the flow of the page instead, as wide as its host and of that
 * height, and it is drawn at once; it may be shown at another width, as on paper.
 */
export function canvasIn(
  host: HTMLElement,
  draw: (pen: Pen, width: number, height: number) => void,
  tall?: (width: number) => number,
) {
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", host.closest("[aria-label]")?.getAttribute("aria-label") ?? "");
  host.prepend(canvas);
  let [width, height] = [host.clientWidth, tall?.(host.clientWidth) ?? host.clientHeight];
  const now = () => {
    waiting.delete(now);
    if (tall) height = tall(width);
    if (width < 8 || height < 8) return;
    draw(penOf(canvas, width, height, tall !== undefined), width, height);
  };
  const redraw = () => requestDrawing(now);
  const observer = new ResizeObserver(([entry]) => {
    const [wide, high] = [Math.floor(entry!.contentRect.width), Math.floor(entry!.contentRect.height)];
    if (wide === width && (tall || high === height)) return;
    [width, height] = [wide, tall?.(wide) ?? high];
    redraw();
  });
  canvases.add(now);
  const number = ++last;
  drawings.set(canvas, () => ({ draw, width, height, number }));
  observer.observe(host);
  if (tall) now();
  else redraw();
  const close = () => {
    observer.disconnect();
    canvases.delete(now);
    waiting.delete(now);
    canvas.remove();
  };
  return { canvas, redraw, close };
}

/** Return a pen for an empty canvas of this size, sharp on the screen and, in the flow of a page, on paper. */
function penOf(canvas: HTMLCanvasElement, width: number, height: number, inFlow: boolean): Pen {
  const ratio = Math.max(inFlow ? 2 : 1, devicePixelRatio);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    if (!inFlow) Object.assign(canvas.style, { width: `${width}px`, height: `${height}px` });
  }
  const pen = canvas.getContext("2d")!;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  reset(pen);
  return pen;
}

/** Give a pen what every drawing begins with. */
export function reset(pen: Pen): void {
  pen.font = `11px ${token("font")}`;
  pen.lineJoin = "round";
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
}

/** Return round numbers within a range, about `wanted` of them. */
export function ticks(low: number, high: number, wanted: number): number[] {
  if (!(high > low)) return [low];
  const raw = (high - low) / Math.max(1, wanted);
  const power = 10 ** Math.floor(Math.log10(raw));
  const share = raw / power;
  const step = (share > 7 ? 10 : share > 3.3 ? 5 : share > 1.4 ? 2 : 1) * power;
  const values: number[] = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
    values.push(Number((k * step).toPrecision(12)));
  return values;
}

/** Height of a line of numbers, in pixels. */
const LINE = 12;

/**
 * Return ticks whose numbers, centred at their places, do not touch each other; at most as many as wanted.
 *
 * @param placeOf where a value is, in pixels: the axis may have any direction.
 * @param widthOf the width of a number, in pixels.
 */
export function ticksApart(
  low: number,
  high: number,
  wanted: number,
  placeOf: (value: number) => readonly [number, number],
  widthOf: (text: string) => number,
): number[] {
  const areApart = (values: number[]): boolean => {
    const wide = Math.max(...tickTexts(values).map(widthOf)) + 4;
    const places = values.map(placeOf);
    return places.every((here, k) => {
      const before = places[k - 1];
      return before === undefined || Math.abs(here[0] - before[0]) >= wide || Math.abs(here[1] - before[1]) >= LINE;
    });
  };
  for (let most = wanted; most > 1; most--) {
    const values = ticks(low, high, most);
    if (values.length > 1 && areApart(values)) return values;
  }
  // one round number says nothing of the scale
  return high > low && areApart([low, high]) ? [low, high] : [low];
}

/** Return the powers of ten within a range, with 2 and 5 times these if they are few. */
export function logTicks(low: number, high: number): number[] {
  const [from, to] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
  const factors = to - from <= 2 ? [1, 2, 5] : [1];
  const values: number[] = [];
  for (let power = from; power <= to; power++) values.push(...factors.map((factor) => factor * 10 ** power));
  const inside = values.filter((value) => value >= low * 0.999 && value <= high * 1.001);
  return inside.length ? inside : [low, high];
}

/** Return the decimals that ticks need. */
export const decimals = (values: number[]): number =>
  Math.min(8, Math.max(0, ...values.map((v) => String(v).split(".")[1]?.length ?? 0)));

/** Write ticks with the same decimals; very large and very small ones with an exponent, if that is shorter. */
export function tickTexts(values: number[]): string[] {
  const largest = Math.max(...values.map(Math.abs));
  const short = (largest >= 1e6 || largest < 1e-4) && values.every((value) => Number(value.toPrecision(3)) === value);
  if (short && largest > 0)
    return values.map((value) => (value === 0 ? "0" : value.toExponential().replace("-", "\u2212")));
  const places = decimals(values);
  return values.map((value) => fixed(value, places));
}

/** Write a tick of a logarithmic axis. */
function powerText(value: number): string {
  const power = Math.round(Math.log10(value));
  if (Math.abs(power) < 5 || Math.abs(Math.log10(value) - power) > 1e-9) return plain(value, 2);
  const digits = String(Math.abs(power)).replace(/\d/g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(digit)]!);
  return `10${power < 0 ? "⁻" : ""}${digits}`;
}

/** Widen a range by a share on both sides, so that nothing touches the frame. */
export function widened([low, high]: Range, share: number): Range {
  if (!(low <= high)) return [0, 1];
  if (low === high) {
    const by = Math.abs(low) * 0.05 || 0.5;
    return [low - by, high + by];
  }
  return [low - (high - low) * share, high + (high - low) * share];
}

/** Return the least and the greatest finite value. */
export function extent(...arrays: ArrayLike<number>[]): Range {
  let [low, high] = [Infinity, -Infinity];
  for (const values of arrays) {
    for (let i = 0; i < values.length; i++) {
      const value = values[i]!;
      if (value < low && value !== -Infinity) low = value;
      if (value > high && value !== Infinity) high = value;
    }
  }
  return [low, high];
}

export interface Box {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

export interface Area {
  x: (value: number) => number;
  y: (value: number) => number;
  xAt: (pixel: number) => number;
  yAt: (pixel: number) => number;
  box: Box;
  clip: (draw: () => void) => void;
}

export interface AreaOptions {
  xTicks?: number[];
  yTicks?: number[];
  title?: string; // below
  unlabelled?: boolean; // no numbers below
  unlabelledY?: boolean; // no numbers beside
  yTitle?: string; // upright, at the left
  scale?: "linear" | "log" | "counts"; // of y
}

/** Draw a plot area and return its scales. */
export function area(pen: Pen, box: Box, xRange: Range, yRange: Range, options: AreaOptions = {}): Area {
  const plot = {
    ...scales(box, xRange, yRange, options.scale === "log"),
    box,
    clip: (draw: () => void) => clip(pen, box, draw),
  };
  const xs = options.xTicks ?? ticks(...xRange, Math.max(2, (box.right - box.left) / 80));
  const ys = options.yTicks ?? yTicks(yRange, (box.bottom - box.top) / 34, options.scale);
  drawGridLines(pen, plot, xs, ys);
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  const yTexts =
    options.scale === "log" ? ys.map(powerText) : options.scale === "counts" ? ys.map(count) : tickTexts(ys);
  if (!options.unlabelledY)
    ys.forEach((value, k) =>
      pen.fillText(yTexts[k]!, box.left - 5, Math.max(box.top + 5, Math.min(box.bottom - 5, plot.y(value)))),
    );
  pen.textBaseline = "top";
  pen.textAlign = "center";
  if (!options.unlabelled) {
    const xTexts = tickTexts(xs);
    xs.forEach((value, k) => {
      const half = pen.measureText(xTexts[k]!).width / 2;
      pen.fillText(xTexts[k]!, Math.min(plot.x(value), box.right + 12 - half), box.bottom + 5);
    });
  }
  pen.textAlign = "right";
  if (options.title) pen.fillText(options.title, box.right, box.bottom + 18);
  if (options.yTitle) drawUpright(pen, box, options.yTitle);
  pen.textBaseline = "alphabetic";
  pen.textAlign = "left";
  return plot;
}

function scales(box: Box, [x0, x1]: Range, yRange: Range, log: boolean): Pick<Area, "x" | "y" | "xAt" | "yAt"> {
  const flat = log ? Math.log10 : (value: number) => value;
  const [y0, y1] = [flat(yRange[0]), flat(yRange[1])];
  const [wide, high] = [box.right - box.left, box.bottom - box.top];
  const yAt = (pixel: number) => y0 + ((box.bottom - pixel) / high) * (y1 - y0);
  return {
    x: (value) => box.left + ((value - x0) / (x1 - x0)) * wide,
    y: (value) => box.bottom - ((flat(value) - y0) / (y1 - y0)) * high,
    xAt: (pixel) => x0 + ((pixel - box.left) / wide) * (x1 - x0),
    yAt: log ? (pixel) => 10 ** yAt(pixel) : yAt,
  };
}

function yTicks(range: Range, wanted: number, scale: AreaOptions["scale"]): number[] {
  if (scale === "log") return logTicks(...range);
  let most = Math.max(2, Math.min(8, wanted));
  let values = ticks(...range, most);
  while (values.length < 2 && range[1] > range[0] && most < 8) values = ticks(...range, ++most);
  return scale === "counts" ? values.filter(Number.isInteger) : values;
}

function drawGridLines(pen: Pen, { x, y, box }: Pick<Area, "x" | "y" | "box">, xs: number[], ys: number[]): void {
  pen.lineWidth = 1;
  pen.strokeStyle = token("grid");
  pen.beginPath();
  for (const value of xs) {
    const at = Math.round(x(value)) + 0.5;
    pen.moveTo(at, box.top);
    pen.lineTo(at, box.bottom);
  }
  for (const value of ys) {
    const at = Math.round(y(value)) + 0.5;
    pen.moveTo(box.left, at);
    pen.lineTo(box.right, at);
  }
  pen.stroke();
  pen.strokeStyle = token("edge");
  pen.strokeRect(box.left + 0.5, box.top + 0.5, Math.round(box.right - box.left), Math.round(box.bottom - box.top));
}

/** Write a title from bottom to top at the left of a plot area, cut to its height. */
export function drawUpright(pen: Pen, box: Box, title: string): void {
  const room = box.bottom - box.top + 20;
  let text = title;
  while (text.length > 3 && pen.measureText(text).width > room) text = `${text.slice(0, -2)}…`;
  pen.save();
  pen.translate(box.left - 48, (box.top + box.bottom) / 2);
  pen.rotate(-Math.PI / 2);
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, 0, 0);
  pen.restore();
}

function clip(pen: Pen, box: Box, draw: () => void): void {
  pen.save();
  pen.beginPath();
  pen.rect(box.left + 1, box.top + 1, box.right - box.left - 1, box.bottom - box.top - 1);
  pen.clip();
  draw();
  pen.restore();
}

/** Draw a line through points; NaN interrupts it. A point that stands alone between gaps is drawn as a dot. */
export function line(
  pen: Pen,
  xs: ArrayLike<number>,
  ys: ArrayLike<number>,
  colour: string,
  width = 1.25,
  breaks?: ReadonlySet<number>,
): void {
  pen.beginPath();
  let up = true;
  for (let k = 0; k < xs.length; k++) {
    const y = ys[k]!;
    if (!Number.isFinite(y)) {
      up = true;
      continue;
    }
    pen[up || breaks?.has(k) ? "moveTo" : "lineTo"](xs[k]!, y);
    if (up && !Number.isFinite(ys[k + 1]!)) pen.rect(xs[k]! - 0.8, y - 0.8, 1.6, 1.6);
    up = false;
  }
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.lineJoin = xs.length > 300 ? "bevel" : "round"; // round joins of many points take most of the time
  pen.stroke();
}
