// A proposed term, as the app draws it.

import { canvasIn } from "../drawing/canvas";
import { drawStep, drawTerm, type ReadTerm } from "../drawing/term";
import { hideTip, make, showTip } from "./elements";
import { numbers, type TermFigure } from "./figures";

const TALL = { step: 220, curve: 380, map: 440, alone: 240 }; // pixels; `alone` has no errors below it

export function drawProposal(host: HTMLElement, f: TermFigure): void {
  const body = make("div", { class: "canvas" });
  host.append(body);
  const deviation = f.deviation.map((value) => value ?? 0);
  const term = { ...f, deviation };
  const errors = { edges: f.edges, x: f.x, error: f.error, before: numbers(f.before), after: numbers(f.after) };
  const tall = f.form === "lag" ? TALL.step : f.second ? TALL.map : f.x.length ? TALL.curve : TALL.alone;
  let read: ReadTerm | undefined;
  const { canvas } = canvasIn(
    body,
    (pen, width, height) => {
      if (f.form === "lag") drawStep(pen, width, height, term, f.form, f.parameter);
      else read = drawTerm(pen, width, height, term, errors, f.form, f.node);
    },
    () => tall,
  );
  canvas.addEventListener("pointermove", (event) => {
    const lines = read?.(event.offsetX, event.offsetY) ?? null;
    if (lines === null) hideTip();
    else
      showTip(
        event,
        lines.map((line) => [line]),
      );
  });
  canvas.addEventListener("pointerleave", hideTip);
}
