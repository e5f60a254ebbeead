// One parameter: its picture, and a table whose cells show the value, the change, the deviation or the samples.

import { plain, withUnit } from "../drawing/numbers";
import { drawCurve, drawFamily } from "./curves";
import { make } from "./elements";
import { numbers, type ParameterFigure } from "./figures";
import { drawHeatMaps } from "./heat-map";
import { Plane } from "./plane";
import { SurfaceView } from "./surface-view";
import { addTable } from "./value-table";

export function drawParameter(host: HTMLElement, f: ParameterFigure): void {
  const plane = new Plane(f);
  const redraws: (() => void)[] = [];
  if (plane.further.length)
    host.append(
      sliders(plane, () => {
        for (const redraw of redraws) redraw();
      }),
    );
  const map = plane.nx > 1 && plane.ny > 1;
  if (plane.block) {
    drawBlock(host, plane, redraws);
    return;
  }
  const row = make("div", { class: map ? "row two pictures" : "row single pictures" });
  host.append(row);
  if (map) {
    const surface = new SurfaceView(part(row), plane);
    redraws.push(() => surface.redraw());
  }
  const curves = part(row);
  const drawCurves = () => {
    curves.replaceChildren();
    if (map) drawFamily(curves, plane, numbers(plane.pick(f.before)), numbers(plane.pick(f.after)));
    else drawCurve(curves, plane);
  };
  drawCurves();
  redraws.push(drawCurves, addTable(host, plane));
}

/** Heat maps; the numbers are folded. */
function drawBlock(host: HTMLElement, plane: Plane, redraws: (() => void)[]): void {
  const row = make("div", { class: plane.changed ? "row two pictures" : "row single pictures" });
  const folded = make("details", {}, make("summary", {}, "Numbers"));
  host.append(row, folded);
  redraws.push(drawHeatMaps(row, plane), addTable(folded, plane));
}

function part(row: HTMLElement): HTMLElement {
  const node = make("div");
  row.append(node);
  return node;
}

/** A slider for each axis beyond the second. */
function sliders(plane: Plane, change: () => void): HTMLElement {
  return make(
    "div",
    { class: "legend" },
    ...plane.further.map((axis, k) => {
      const name = withUnit(axis.title, axis.unit);
      const text = make("output");
      const show = () => {
        text.textContent = `${name} = ${plain(axis.points[plane.chosen[k]!]!, 6)}`;
      };
      const slider = make("input", {
        type: "range",
        min: "0",
        max: String(axis.points.length - 1),
        step: "1",
        value: String(plane.chosen[k]),
        "aria-label": name,
      });
      slider.addEventListener("input", () => {
        plane.chosen[k] = Number(slider.value);
        show();
        change();
      });
      show();
      return make("label", { class: "slider" }, slider, text);
    }),
  );
}
