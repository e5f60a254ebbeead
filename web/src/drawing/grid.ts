// Maps as coloured cells, x to the right and y upwards, of equal size: points that lie close together stay readable.

import { type Box, extent, type Pen, type Range } from "./canvas";
import { css, diverging, height as heightColour, token } from "./colours";
import { hatch } from "./marks";
import { plain } from "./numbers";

export interface Grid {
  x: Range;
  y: Range;
  values: number[][];
  range?: Range;
  difference?: boolean;
}

/** Fill the cells of a box with colours; an empty cell, null, is hatched. Returns the edges of a cell. */
export function drawCells(
  pen: Pen,
  box: Box,
  nx: number,
  ny: number,
  paint: (i: number, j: number) => string | null,
): (i: number, j: number) => Box {
  const x = (i: number) => Math.round(box.left + ((box.right - box.left) * i) / nx);
  const y = (j: number) => Math.round(box.bottom - ((box.bottom - box.top) * j) / ny);
  for (let i = 0; i < nx; i++) {
    for (let j = 0; j < ny; j++) {
      const colour = paint(i, j);
      pen.fillStyle = colour ?? token("ground");
      pen.beginPath();
      pen.rect(x(i), y(j + 1), x(i + 1) - x(i), y(j) - y(j + 1));
      pen.fill();
      if (colour === null) hatch(pen);
    }
  }
  return (i, j) => ({ left: x(i), right: x(i + 1), top: y(j + 1), bottom: y(j) });
}

/** The cell of a box at a pixel, as `drawCells` draws them; null beside it. */
export function cellIn(box: Box, nx: number, ny: number, x: number, y: number): [number, number] | null {
  const i = Math.floor(((x - box.left) / (box.right - box.left)) * nx);
  const j = Math.floor(((box.bottom - y) / (box.bottom - box.top)) * ny);
  return i >= 0 && j >= 0 && i < nx && j < ny ? [i, j] : null;
}

/** Draw a map with the ends of its axes; returns which cell is at a pixel. */
export function drawGrid(
  pen: Pen,
  width: number,
  height: number,
  grid: Grid,
  marks: (i: number, j: number) => "hatch" | "frame" | "" = () => "",
): (x: number, y: number) => [number, number] | null {
  const [nx, ny] = [grid.values.length, grid.values[0]?.length ?? 0];
  if (!nx || !ny) return () => null;
  const box = { left: 40, right: width - 12, top: 6, bottom: height - 20 };
  const [low, high] = grid.range ?? extent(grid.values.flat());
  const reach = Math.max(Math.abs(low), Math.abs(high)) || 1;
  const colour = (value: number) =>
    grid.difference ? diverging(value / reach) : heightColour(high > low ? (value - low) / (high - low) : 0.35);
  const edges = drawCells(pen, box, nx, ny, (i, j) => css(colour(grid.values[i]![j]!)));
  for (let i = 0; i < nx; i++) {
    for (let j = 0; j < ny; j++) {
      const mark = marks(i, j);
      if (!mark) continue;
      const { left, right, top, bottom } = edges(i, j);
      pen.beginPath();
      if (mark === "hatch") {
        pen.rect(left, top, right - left, bottom - top);
        hatch(pen);
      } else {
        pen.rect(left + 1, top + 1, right - left - 2, bottom - top - 2);
        pen.strokeStyle = token("error");
        pen.stroke();
      }
    }
  }
  labelEnds(pen, box, grid);
  return (x, y) => cellIn(box, nx, ny, x, y);
}

function labelEnds(pen: Pen, box: Box, { x, y }: Grid): void {
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  pen.fillText(plain(y[1], 4), box.left - 5, box.top + 5);
  pen.fillText(plain(y[0], 4), box.left - 5, box.bottom - 5);
  pen.textBaseline = "top";
  pen.fillText(plain(x[1], 4), box.right, box.bottom + 4);
  pen.textAlign = "left";
  pen.fillText(plain(x[0], 4), box.left, box.bottom + 4);
  pen.textBaseline = "alphabetic";
}

/** Draw a scale of colours beside a picture, with the values at its ends, and zero if it lies between. */
export function drawScale(pen: Pen, box: Box, [low, high]: Range, paint: (value: number) => string): void {
  const steps = 40;
  const tall = (box.bottom - box.top) / steps;
  for (let k = 0; k < steps; k++) {
    pen.fillStyle = paint(low + ((k + 0.5) / steps) * (high - low));
    pen.fillRect(box.left, box.bottom - (k + 1) * tall, box.right - box.left, tall + 0.6);
  }
  pen.strokeStyle = token("edge");
  pen.lineWidth = 1;
  pen.strokeRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "left";
  pen.fillText(plain(high, 3), box.right + 5, box.top + 5);
  pen.fillText(plain(low, 3), box.right + 5, box.bottom - 5);
  if (low < 0 && high > 0) pen.fillText("0", box.right + 5, box.bottom + (low / (high - low)) * (box.bottom - box.top));
  pen.textBaseline = "alphabetic";
}
