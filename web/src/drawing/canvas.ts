// Canvases that follow the size of their host, and plot areas with grid, ticks and titles.

import { token } from "./colours";
import { fixed } from "./numbers";

export type Pen = CanvasRenderingContext2D;
export type Range = readonly [number, number];

/** Draw into a host whenever it changes its size; returns a function that draws again, at most once a frame. */
export function canvasIn(host: HTMLElement, draw: (pen: Pen, width: number, height: number) => void) {
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", host.getAttribute("aria-label") ?? "");
  host.prepend(canvas);
  let asked = 0;
  const now = () => {
    asked = 0;
    const [width, height] = [host.clientWidth, host.clientHeight];
    if (width < 8 || height < 8) return;
    const ratio = Math.max(1, devicePixelRatio);
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.width = `${width}px`;
      canvas.style.height = `${height}px`;
    }
    const pen = canvas.getContext("2d")!;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = `11px ${token("font")}`;
    pen.lineJoin = "round";
    pen.textAlign = "left";
    pen.textBaseline = "alphabetic";
    draw(pen, width, height);
  };
  const redraw = () => {
    if (!asked) asked = requestAnimationFrame(now);
  };
  const observer = new ResizeObserver(redraw);
  observer.observe(host);
  redraw();
  return { canvas, redraw, close: () => { observer.disconnect(); cancelAnimationFrame(asked); canvas.remove(); } };
}

/** Return round numbers within a range, about `wanted` of them. */
export function ticks(low: number, high: number, wanted: number): number[] {
  if (!(high > low)) return [low];
  const raw = (high - low) / Math.max(1, wanted);
  const power = 10 ** Math.floor(Math.log10(raw));
  const share = raw / power;
  const step = (share > 7 ? 10 : share > 3.3 ? 5 : share > 1.4 ? 2 : 1) * power;
  const values: number[] = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(Number((k * step).toPrecision(12)));
  return values;
}

/** Return the decimals that ticks need. */
export const decimals = (values: number[]): number => Math.min(8, Math.max(0, ...values.map((v) => String(v).split(".")[1]?.length ?? 0)));

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

export interface Box { left: number; right: number; top: number; bottom: number }

export interface Area {
  x: (value: number) => number;
  y: (value: number) => number;
  box: Box;
  clip: (draw: () => void) => void;
}

export interface AreaOptions {
  xTicks?: number[];
  yTicks?: number[];
  title?: string;
  unlabelled?: boolean; // no numbers below
  unlabelledY?: boolean; // no numbers beside
}

/** Draw a plot area and return its scales. */
export function area(pen: Pen, box: Box, xRange: Range, yRange: Range, options: AreaOptions = {}): Area {
  const x = (value: number) => box.left + ((value - xRange[0]) / (xRange[1] - xRange[0])) * (box.right - box.left);
  const y = (value: number) => box.bottom - ((value - yRange[0]) / (yRange[1] - yRange[0])) * (box.bottom - box.top);
  const xs = options.xTicks ?? ticks(...xRange, Math.max(2, (box.right - box.left) / 80));
  const ys = options.yTicks ?? ticks(...yRange, Math.max(2, (box.bottom - box.top) / 34));
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
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  const yDecimals = decimals(ys);
  if (!options.unlabelledY) for (const value of ys) pen.fillText(fixed(value, yDecimals), box.left - 5, Math.max(box.top + 5, Math.min(box.bottom - 5, y(value))));
  pen.textBaseline = "top";
  pen.textAlign = "center";
  const xDecimals = decimals(xs);
  if (!options.unlabelled) {
    for (const value of xs) {
      const text = fixed(value, xDecimals);
      const half = pen.measureText(text).width / 2;
      pen.fillText(text, Math.min(x(value), box.right + 12 - half), box.bottom + 5);
    }
  }
  if (options.title) {
    pen.textAlign = "right";
    pen.fillText(options.title, box.right, box.bottom + 18);
  }
  pen.textBaseline = "alphabetic";
  pen.textAlign = "left";
  const clip = (draw: () => void) => {
    pen.save();
    pen.beginPath();
    pen.rect(box.left + 1, box.top + 1, box.right - box.left - 1, box.bottom - box.top - 1);
    pen.clip();
    draw();
    pen.restore();
  };
  return { x, y, box, clip };
}

/** Draw a line through points; NaN interrupts it. */
export function line(pen: Pen, xs: ArrayLike<number>, ys: ArrayLike<number>, colour: string, width = 1.25): void {
  pen.beginPath();
  let up = true;
  for (let k = 0; k < xs.length; k++) {
    if (!Number.isFinite(ys[k]!)) up = true;
    else {
      pen[up ? "moveTo" : "lineTo"](xs[k]!, ys[k]!);
      up = false;
    }
  }
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.stroke();
}

/** Hatch a polygon that is the current path, which stays the current path. */
export function hatch(pen: Pen, corners: readonly (readonly [number, number])[]): void {
  const xs = corners.map((p) => p[0]);
  const ys = corners.map((p) => p[1]);
  const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  pen.save();
  pen.clip();
  pen.beginPath();
  for (let at = left - (bottom - top); at < right; at += 4.5) {
    pen.moveTo(at, bottom);
    pen.lineTo(at + bottom - top, top);
  }
  pen.strokeStyle = token("hatch");
  pen.lineWidth = 1;
  pen.stroke();
  pen.restore();
}
