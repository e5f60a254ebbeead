// A canvas that is drawn again when something that it shows changes.

import { useLayoutEffect, useRef } from "preact/hooks";
import { canvasIn, type Pen } from "../drawing/canvas";
import { type Read, tipOn } from "../hover-tip";
import { theme } from "../store";

type Place = [pen: Pen, width: number, height: number];
/** Draws a picture; may return how it is read at a pixel. */
export type Draw = ((...place: Place) => Read | undefined) | ((...place: Place) => void);

export function Picture({ label, draw, of, kind = "" }: { label: string; draw: Draw; of: unknown[]; kind?: string }) {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  const latest = useRef(draw);
  latest.current = draw;
  useLayoutEffect(() => {
    let read: Read | undefined;
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, width, height) => {
      read = latest.current(pen, width, height) as Read | undefined;
    });
    redraw.current = again;
    const silence = tipOn(canvas, (x, y) => read?.(x, y) ?? null);
    return () => {
      silence();
      close();
    };
  }, []);
  useLayoutEffect(() => redraw.current(), [...of, theme.value]);
  return <div class={`canvas ${kind}`} ref={host} aria-label={label} />;
}
