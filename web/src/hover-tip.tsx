// The values under the mouse on a picture, in a small box beside it.

import { signal } from "@preact/signals";

/** Reads a picture at a pixel: lines of text, the first one in bold; null where nothing is drawn. */
export type Read = (x: number, y: number) => string[] | null;

const shown = signal<{ left: number; top: number; lines: string[] } | null>(null);

/** Show what a canvas has under the mouse, unless a button is held: what is dragged says itself what it does. */
export function tipOn(canvas: HTMLCanvasElement, read: Read): () => void {
  const follow = (event: PointerEvent): void => {
    const lines = event.buttons === 0 ? read(event.offsetX, event.offsetY) : null;
    shown.value = lines === null ? null : { left: event.clientX, top: event.clientY, lines };
  };
  const hide = (): void => {
    shown.value = null;
  };
  const hiding = ["pointerleave", "pointerdown", "wheel"] as const;
  canvas.addEventListener("pointermove", follow);
  for (const name of hiding) canvas.addEventListener(name, hide, { passive: true });
  return () => {
    canvas.removeEventListener("pointermove", follow);
    for (const name of hiding) canvas.removeEventListener(name, hide);
    hide();
  };
}

const GAP = 14; // pixels from the mouse
const ROOM = { wide: 240, line: 16, rest: 12 }; // for a box beyond whose place the window ends

export function HoverTip() {
  if (shown.value === null) return null;
  const { left, top, lines } = shown.value;
  const high = lines.length * ROOM.line + ROOM.rest + GAP;
  const style = {
    ...(left + ROOM.wide > innerWidth ? { right: `${innerWidth - left + GAP}px` } : { left: `${left + GAP}px` }),
    top: `${top + high > innerHeight ? top - high : top + GAP}px`,
  };
  return (
    <div class="tip under" style={style} aria-hidden="true">
      {lines.map((text, k) => (
        <div key={k} class={k === 0 ? "ink strong" : ""}>
          {text}
        </div>
      ))}
    </div>
  );
}

/** The number of the entry that is nearest to a value; -1 if there is none. */
export function nearestTo(values: ArrayLike<number>, value: number): number {
  let best = -1;
  for (let k = 0; k < values.length; k++)
    if (Number.isFinite(values[k]) && (best < 0 || Math.abs(values[k]! - value) < Math.abs(values[best]! - value)))
      best = k;
  return best;
}

/** The number of the place that is nearest to a pixel, not farther than `reach`; -1 if there is none. */
export function nearestPixel(
  xs: ArrayLike<number>,
  ys: ArrayLike<number>,
  [x, y]: readonly [number, number],
  reach: number,
): number {
  let [best, nearest] = [reach ** 2, -1];
  for (let k = 0; k < ys.length; k++) {
    const distance = (xs[k]! - x) ** 2 + (ys[k]! - y) ** 2;
    if (distance < best) [best, nearest] = [distance, k];
  }
  return nearest;
}
