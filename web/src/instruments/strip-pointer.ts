// The mouse on the strips: drag to zoom, measure or brush, wheel to zoom, click for the cursor.

import { signal } from "@preact/signals";
import {
  back,
  brush,
  cursor,
  hover,
  part,
  range,
  type Stretch,
  shift,
  tool,
  visible,
  width,
  zoom,
  zoomAt,
} from "../plots";
import { active, rowAt } from "../strip-rows";

export const LEFT = 44; // pixels beside the strips
export const RIGHT = 12;
export const pending = signal<Stretch | null>(null); // being dragged to zoom

/** Listen to a canvas; returns a function that stops. */
export function listen(canvas: HTMLCanvasElement): () => void {
  let from: number | null = null;
  let mode: "zoom" | "range" | "brush" | "pan" = "zoom";
  const position = (event: MouseEvent) => {
    const box = canvas.getBoundingClientRect();
    const { begin, end } = visible.value;
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return begin + Math.max(0, Math.min(1, share)) * (end - begin);
  };
  const between = (a: number, b: number): Stretch => ({ begin: tidy(Math.min(a, b)), end: tidy(Math.max(a, b)) });
  const target = () => ({ zoom: pending, range, brush, pan: null })[mode];
  const small = (a: number, b: number) => Math.abs(a - b) < (visible.value.end - visible.value.begin) / 250;
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    from = position(event);
    mode = event.shiftKey ? "brush" : event.ctrlKey || event.button === 1 ? "pan" : tool.value;
    const box = canvas.getBoundingClientRect();
    active.value = rowAt((event.clientY - box.top) / box.height);
  };
  canvas.onpointermove = (event) => {
    hover.value = position(event);
    if (from === null) return;
    if (mode === "pan") shift(from - hover.value);
    else if (!small(from, hover.value)) {
      target()!.value = between(from, hover.value);
      if (mode === "brush") part.value = "point";
    }
  };
  canvas.onpointerup = (event) => {
    if (from === null) return;
    const [begin, to] = [from, position(event)];
    from = pending.value = null;
    if (mode === "pan") return;
    if (small(begin, to)) cursor.value = to;
    else if (mode === "zoom") zoom(between(begin, to));
  };
  canvas.onpointerleave = () => {
    if (from === null) hover.value = null;
  };
  const wheel = (event: WheelEvent) => {
    if (event.altKey) return;
    event.preventDefault();
    if (event.deltaX) shift((event.deltaX / width.value) * (visible.value.end - visible.value.begin));
    if (event.deltaY) zoomAt(position(event), Math.exp(event.deltaY * 0.0015));
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
  canvas.ondblclick = back;
  return () => canvas.removeEventListener("wheel", wheel);
}

/** Round a position to what a pixel can tell, so that conditions stay readable. */
function tidy(position: number): number {
  const step = (visible.value.end - visible.value.begin) / Math.max(1, width.value);
  const places = Math.max(0, Math.min(12, Math.ceil(-Math.log10(step))));
  return Number(position.toFixed(places));
}
