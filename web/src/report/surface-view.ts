// The surface of a map, before and after, which can be turned by dragging or with the arrow keys.

import { canvasIn } from "../drawing/canvas";
import { css, height, token } from "../drawing/colours";
import { ring } from "../drawing/marks";
import { Surface, type SurfaceMap } from "../drawing/surface";
import { hideTip, make, showTip, toggle } from "./elements";
import { numbers } from "./figures";
import type { Plane } from "./plane";

export class SurfaceView {
  readonly redraw: () => void;
  private readonly drawing = new Surface();
  private readonly shown = { now: true, reference: true };
  private highlight: number | null = null;

  constructor(
    host: HTMLElement,
    private readonly plane: Plane,
  ) {
    host.append(this.legend());
    const box = make("div", { class: "canvas surface" });
    host.append(box);
    const tall = (width: number) => Math.max(260, Math.min(400, width * 0.72));
    const { canvas, redraw } = canvasIn(
      box,
      (pen, width, height) => {
        this.drawing.draw(pen, width, height, this.map());
        const point = this.highlight === null ? undefined : this.drawing.points[this.highlight];
        if (point) ring(pen, point, 4, token("paper"), token("ink"), 1.5);
      },
      tall,
    );
    this.redraw = redraw;
    canvas.tabIndex = 0;
    this.listen(canvas);
  }

  private map(): SurfaceMap {
    const { f, x, y, changed } = this.plane;
    const { now, reference } = this.shown;
    const samples = f.samples && this.plane.pick(f.samples);
    return {
      x,
      y: y!,
      unit: f.unit,
      now: numbers(this.plane.pick(f.after)),
      reference: changed ? numbers(this.plane.pick(f.before)) : null,
      empty: samples && ((cell) => samples[cell] === 0),
      hidden: now ? (reference ? "" : "reference") : reference && changed ? "now" : "both",
    };
  }

  private legend(): HTMLElement {
    const entry = (key: "now" | "reference", name: string, colour: string) =>
      toggle(colour, name, true, (shown) => {
        this.shown[key] = shown;
        this.redraw();
      });
    const { changed } = this.plane;
    return make(
      "div",
      { class: "legend" },
      changed ? entry("reference", "before", "before") : null,
      entry("now", changed ? "after" : "value", css(height(0.4))),
      make("span", { class: "hint" }, "drag to rotate, double-click to reset"),
    );
  }

  private listen(canvas: HTMLCanvasElement): void {
    const { camera } = this.drawing;
    let from: { x: number; y: number; azimuth: number; elevation: number } | null = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = { x: event.clientX, y: event.clientY, azimuth: camera.azimuth, elevation: camera.elevation };
      canvas.setPointerCapture(event.pointerId);
    });
    for (const end of ["pointerup", "pointercancel"])
      canvas.addEventListener(end, () => {
        from = null;
      });
    canvas.addEventListener("pointermove", (event) => {
      if (from === null) this.point(event);
      else {
        hideTip();
        this.turn(from.azimuth + (event.clientX - from.x) * 0.009, from.elevation + (event.clientY - from.y) * 0.007);
      }
    });
    canvas.addEventListener("pointerleave", () => {
      hideTip();
      this.mark(null);
    });
    canvas.addEventListener("dblclick", () => {
      camera.reset();
      this.redraw();
    });
    canvas.addEventListener("keydown", (event) => {
      const by = (
        { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] } as Record<
          string,
          [number, number]
        >
      )[event.key];
      if (by === undefined) return;
      event.preventDefault();
      this.turn(camera.azimuth + by[0], camera.elevation + by[1]);
    });
  }

  private turn(azimuth: number, elevation: number): void {
    this.drawing.camera.turnTo(azimuth, elevation);
    this.redraw();
  }

  private mark(cell: number | null): void {
    if (cell === this.highlight) return;
    this.highlight = cell;
    this.redraw();
  }

  private point(event: PointerEvent): void {
    const cell = this.drawing.nearest(event.offsetX, event.offsetY, 18);
    this.mark(cell);
    if (cell === null) hideTip();
    else showTip(event, this.plane.describe(Math.floor(cell / this.plane.ny), cell % this.plane.ny));
  }
}
