// A canvas that is drawn again when something that it shows changes.

import { useLayoutEffect, useRef } from "preact/hooks";
import { canvasIn, type Pen } from "../drawing/canvas";
import { theme } from "../store";

export type Draw = (pen: Pen, width: number, height: number) => void;

export function Picture({ label, draw, of, kind = "" }: { label: string; draw: Draw; of: unknown[]; kind?: string }) {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  const latest = useRef(draw);
  latest.current = draw;
  useLayoutEffect(() => {
    const { redraw: again, close } = canvasIn(host.current!, (pen, width, height) =>
      latest.current(pen, width, height),
    );
    redraw.current = again;
    return close;
  }, []);
  useLayoutEffect(() => redraw.current(), [...of, theme.value]);
  return <div class={`canvas ${kind}`} ref={host} aria-label={label} />;
}
