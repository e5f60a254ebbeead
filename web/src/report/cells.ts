// The errors by cell of a table: mean, RMSE and number of samples between neighbouring breakpoints.

import { type Box, canvasIn, drawUpright, type Pen } from "../drawing/canvas";
import { amount, css, diverging, token } from "../drawing/colours";
import { drawCells, drawScale } from "../drawing/grid";
import { plain, withUnit } from "../drawing/numbers";
import { choice, hideTip, make, showTip, type TipLine } from "./elements";
import type { AxisData, CellErrors, CellsFigure } from "./figures";

type Mode = keyof CellErrors;

export function drawCellErrors(host: HTMLElement, f: CellsFigure): void {
  new CellPicture(host, f);
}

class CellPicture {
  private use: string;
  private mode: Mode = "mean";
  private box: Box = { left: 0, right: 1, top: 0, bottom: 1 };

  constructor(
    host: HTMLElement,
    private readonly f: CellsFigure,
  ) {
    const uses = Object.keys(f.uses);
    this.use = uses[0]!;
    const modes = choice({ "mean error": "mean", RMSE: "rmse", samples: "samples" }, "mean", (mode) => {
      this.mode = mode as Mode;
      redraw();
    });
    const parts =
      uses.length > 1
        ? choice(Object.fromEntries(uses.map((use) => [use, use])), this.use, (use) => {
            this.use = use;
            redraw();
          })
        : null;
    const body = make("div", { class: "canvas" });
    host.append(make("div", { class: "legend" }, modes, parts), body);
    const { canvas, redraw } = canvasIn(
      body,
      (pen, width, height) => this.draw(pen, width, height),
      () => (this.flat ? 130 : 250),
    );
    canvas.addEventListener("pointermove", (event) => this.point(event));
    canvas.addEventListener("pointerleave", hideTip);
  }

  private get flat(): boolean {
    return this.f.axes.length === 1;
  }

  /** Number of cells along each axis. */
  private get size(): [number, number] {
    const samples = this.f.uses[this.use]!.samples;
    return [samples.length, Array.isArray(samples[0]) ? samples[0].length : 1];
  }

  private value(mode: Mode, i: number, j: number): number {
    const row = this.f.uses[this.use]![mode][i];
    return (Array.isArray(row) ? row[j] : row) ?? NaN;
  }

  private draw(pen: Pen, width: number, height: number): void {
    const [nx, ny] = this.size;
    this.box = { left: this.flat ? 16 : 62, right: width - 74, top: 6, bottom: height - 38 };
    const paint = this.paint();
    drawCells(pen, this.box, nx, ny, (i, j) =>
      this.value("samples", i, j) === 0 ? null : paint(this.value(this.mode, i, j)),
    );
    pen.strokeStyle = token("edge");
    pen.lineWidth = 1;
    pen.strokeRect(this.box.left, this.box.top, this.box.right - this.box.left, this.box.bottom - this.box.top);
    this.label(pen, nx, ny);
    const most = this.most();
    drawScale(
      pen,
      { ...this.box, left: this.box.right + 12, right: this.box.right + 22 },
      [this.mode === "mean" ? -most : 0, most],
      paint,
    );
  }

  private most(): number {
    const [nx, ny] = this.size;
    const values = Array.from({ length: nx * ny }, (_, k) =>
      Math.abs(this.value(this.mode, Math.floor(k / ny), k % ny)),
    );
    return Math.max(1e-300, ...values.filter(Number.isFinite));
  }

  private paint(): (value: number) => string {
    const most = this.most();
    if (this.mode === "mean") return (value) => css(diverging(value / most));
    const hue = this.mode === "rmse" ? "amber" : "blue";
    return (value) => amount(value / most, hue);
  }

  private label(pen: Pen, nx: number, ny: number): void {
    const { left, right, top, bottom } = this.box;
    const [x, y] = this.f.axes;
    pen.fillStyle = token("quiet");
    pen.textBaseline = "top";
    pen.textAlign = "center";
    for (const i of edges(x!, nx, (right - left) / 46))
      pen.fillText(plain(x!.points[i]!, 4), left + (i / nx) * (right - left), bottom + 5);
    pen.textAlign = "right";
    pen.fillText(withUnit(x!.title, x!.unit), right, bottom + 20);
    if (y !== undefined) {
      pen.textBaseline = "middle";
      for (const j of edges(y, ny, (bottom - top) / 18))
        pen.fillText(plain(y.points[j]!, 4), left - 5, bottom - (j / ny) * (bottom - top));
      drawUpright(pen, this.box, withUnit(y.title, y.unit));
    }
    pen.textBaseline = "alphabetic";
  }

  private point(event: PointerEvent): void {
    const [nx, ny] = this.size;
    const { left, right, top, bottom } = this.box;
    const i = Math.floor(((event.offsetX - left) / (right - left)) * nx);
    const j = Math.floor(((bottom - event.offsetY) / (bottom - top)) * ny);
    if (i < 0 || j < 0 || i >= nx || j >= ny) {
      hideTip();
      return;
    }
    const { axes, unit } = this.f;
    const places = axes.map<TipLine>((axis, k) => [describeSpan(axis, k === 0 ? i : j)]);
    const [mean, rmse] = [plain(this.value("mean", i, j), 4), plain(this.value("rmse", i, j), 4)];
    showTip(event, [
      ...places,
      [`mean error ${mean} ${unit}`, "error"],
      [`RMSE ${rmse} ${unit}`],
      [`${this.value("samples", i, j)} samples, ${this.use}`],
    ]);
  }
}

function describeSpan(axis: AxisData, k: number): string {
  const end = axis.points.length > 1 ? ` to ${plain(axis.points[k + 1]!, 5)}` : "";
  return `${axis.title} ${plain(axis.points[k]!, 5)}${end} ${axis.unit}`;
}

/** The numbers of the breakpoints that there is room to write. */
function edges(axis: AxisData, cells: number, room: number): number[] {
  const all = Array.from({ length: Math.min(axis.points.length, cells + 1) }, (_, k) => k);
  const every = Math.max(1, Math.ceil(all.length / Math.max(Math.floor(room), 2)));
  return all.filter((k) => k % every === 0);
}
