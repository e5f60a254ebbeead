// A canvas that is drawn again when something that it shows changes, and small pictures of tables.

import { useEffect, useRef } from "preact/hooks";
import { area, canvasIn, extent, line, widened, type Pen } from "../drawing/canvas";
import { css, diverging, height as heightColour, token } from "../drawing/colours";
import { plain } from "../drawing/numbers";
import { theme } from "../store";

export type Draw = (pen: Pen, width: number, height: number) => void;

export function Picture({ label, draw, of, kind = "" }: { label: string; draw: Draw; of: unknown[]; kind?: string }) {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  const latest = useRef(draw);
  latest.current = draw;
  useEffect(() => {
    const { redraw: again, close } = canvasIn(host.current!, (pen, width, height) => latest.current(pen, width, height));
    redraw.current = again;
    return close;
  }, []);
  useEffect(() => redraw.current(), [...of, theme.value]);
  return <div class={`canvas ${kind}`} ref={host} aria-label={label} />;
}

export interface Grid { x: readonly [number, number]; y: readonly [number, number]; values: number[][]; range?: readonly [number, number]; difference?: boolean }

/** Draw a map as coloured cells, x to the right and y upwards, with the ends of its axes. */
export function drawGrid(pen: Pen, width: number, height: number, grid: Grid, marks: (i: number, j: number) => "hatch" | "frame" | "" = () => ""): void {
  const [nx, ny] = [grid.values.length, grid.values[0]?.length ?? 0];
  if (!nx || !ny) return;
  const box = { left: 40, right: width - 12, top: 6, bottom: height - 20 };
  const [low, high] = grid.range ?? extent(grid.values.flat());
  const reach = Math.max(Math.abs(low), Math.abs(high)) || 1;
  const edgeX = (i: number) => Math.round(box.left + ((box.right - box.left) * i) / nx);
  const edgeY = (j: number) => Math.round(box.bottom - ((box.bottom - box.top) * j) / ny);
  for (let i = 0; i < nx; i++) {
    for (let j = 0; j < ny; j++) {
      const value = grid.values[i]![j]!;
      const [x, y, w, h] = [edgeX(i), edgeY(j + 1), edgeX(i + 1) - edgeX(i), edgeY(j) - edgeY(j + 1)];
      pen.fillStyle = css(grid.difference ? diverging(value / reach) : heightColour(high > low ? (value - low) / (high - low) : 0.35));
      pen.fillRect(x, y, w, h);
      const mark = marks(i, j);
      if (mark === "hatch") {
        pen.fillStyle = token("hatch");
        for (let k = 0; k < w; k += 4) pen.fillRect(x + k, y, 1, h);
      } else if (mark === "frame") {
        pen.strokeStyle = token("error");
        pen.strokeRect(x + 1, y + 1, w - 2, h - 2);
      }
    }
  }
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  pen.fillText(plain(grid.y[1], 4), box.left - 5, box.top + 5);
  pen.fillText(plain(grid.y[0], 4), box.left - 5, box.bottom - 5);
  pen.textBaseline = "top";
  pen.textAlign = "left";
  pen.fillText(plain(grid.x[0], 4), box.left, box.bottom + 4);
  pen.textAlign = "right";
  pen.fillText(plain(grid.x[1], 4), box.right, box.bottom + 4);
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
}

/** Draw curves over one axis: the earlier in grey, the later in blue with its points. */
export function drawCurves(pen: Pen, width: number, height: number, x: readonly [number, number] | number[], before: number[], now: number[]): void {
  const box = { left: 40, right: width - 12, top: 6, bottom: height - 20 };
  const points = x.length === now.length ? [...x] : now.map((_, k) => x[0]! + ((x[x.length - 1]! - x[0]!) * k) / Math.max(1, now.length - 1));
  const plot = area(pen, box, widened(extent(points), 0), widened(extent(before, now), 0.08));
  const xs = points.map(plot.x);
  plot.clip(() => {
    line(pen, xs, before.map(plot.y), token("before"), 1.25);
    line(pen, xs, now.map(plot.y), token("model"), 1.5);
    pen.fillStyle = token("model");
    now.forEach((value, k) => {
      pen.beginPath();
      pen.arc(xs[k]!, plot.y(value), 2.2, 0, 7);
      pen.fill();
    });
  });
}
