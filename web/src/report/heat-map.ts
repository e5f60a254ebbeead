// A value block: its rows and columns are positions only, so it is drawn as coloured cells, before and after.

import { type Box, canvasIn, type Pen } from "../drawing/canvas";
import { css, diverging, token } from "../drawing/colours";
import { drawCells, drawScale } from "../drawing/grid";
import { withUnit } from "../drawing/numbers";
import { hideTip, make, showTip } from "./elements";
import { numbers, type Values } from "./figures";
import type { Plane } from "./plane";

const TALL = 12; // pixels of a row, if there is room
const MOST_WIDE = 48; // pixels of a column
const LEAST_WIDE = 120; // pixels of all columns
const MARGIN = { left: 34, right: 64, top: 6, bottom: 22 };

/** Draw a block before and after side by side, in colours of one scale; returns a function that draws it again. */
export function drawHeatMaps(host: HTMLElement, plane: Plane): () => void {
  const { f, changed } = plane;
  const most = Math.max(1e-300, ...[...numbers(f.before), ...numbers(f.after)].filter(Number.isFinite).map(Math.abs));
  const shown: [string, Values][] = changed
    ? [
        ["before", f.before],
        ["after", f.after],
      ]
    : [["value", f.after]];
  const redraws = shown.map(([title, values]) => drawHeatMap(host, plane, title, values, most));
  return () => {
    for (const redraw of redraws) redraw();
  };
}

function drawHeatMap(host: HTMLElement, plane: Plane, title: string, values: Values, most: number): () => void {
  const { nx, ny } = plane;
  const body = make("div", { class: "canvas" });
  host.append(make("div", {}, make("div", { class: "legend" }, withUnit(title, plane.f.unit)), body));
  const tall = Math.max(40, Math.min(260, TALL * ny)) + MARGIN.top + MARGIN.bottom;
  let box: Box = { left: 0, right: 1, top: 0, bottom: 1 };
  const paint = (value: number) => css(diverging(value / most));
  const { canvas, redraw } = canvasIn(
    body,
    (pen, width, height) => {
      const wide = Math.min(width - MARGIN.left - MARGIN.right, Math.max(LEAST_WIDE, MOST_WIDE * nx));
      box = { left: MARGIN.left, right: MARGIN.left + wide, top: MARGIN.top, bottom: height - MARGIN.bottom };
      const shown = numbers(plane.pick(values));
      drawCells(pen, box, nx, ny, (i, j) => {
        const value = shown[i * ny + ny - 1 - j]!; // the first row is at the top
        return Number.isFinite(value) ? paint(value) : null;
      });
      drawScale(pen, { ...box, left: box.right + 10, right: box.right + 20 }, [-most, most], paint);
      label(pen, box, plane);
    },
    () => tall,
  );
  canvas.addEventListener("pointermove", (event) => {
    const i = Math.floor(((event.offsetX - box.left) / (box.right - box.left)) * nx);
    const j = Math.floor(((event.offsetY - box.top) / (box.bottom - box.top)) * ny);
    if (i < 0 || j < 0 || i >= nx || j >= ny) hideTip();
    else showTip(event, plane.describe(i, j));
  });
  canvas.addEventListener("pointerleave", hideTip);
  return redraw;
}

/** Write the ends of rows and columns. */
function label(pen: Pen, { left, right, top, bottom }: Box, { x, y, nx, ny }: Plane): void {
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  pen.fillText("0", left - 5, top + 6);
  if (ny > 1) pen.fillText(String(ny - 1), left - 5, bottom - 6);
  pen.textBaseline = "top";
  pen.textAlign = "left";
  pen.fillText("0", left, bottom + 5);
  pen.textAlign = "center";
  pen.fillText(`${y?.title ?? ""} ↓  ${x.title} →`, (left + right) / 2, bottom + 5);
  pen.textAlign = "right";
  if (nx > 1) pen.fillText(String(nx - 1), right, bottom + 5);
  pen.textBaseline = "alphabetic";
}
