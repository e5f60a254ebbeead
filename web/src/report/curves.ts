// A curve with its uncertainty and samples, and the family of curves that a map is.

import { css, family } from "../drawing/colours";
import { plain, withUnit } from "../drawing/numbers";
import { nearest } from "../drawing/strips";
import { Chart, type Pane } from "./chart";
import { make, swatch } from "./elements";
import { numbers } from "./figures";
import { bandLayer, familyLayer, type Layer, lineLayer, type Points, stemsLayer, uprightLayer } from "./layers";
import type { Plane } from "./plane";

/** Lines over the longer axis, one for each breakpoint of the other, at most about ten. */
export function drawFamily(host: HTMLElement, plane: Plane, before: number[], after: number[]): void {
  const { f, nx, ny, changed } = plane;
  const overX = nx >= ny;
  const [along, across] = overX ? [plane.x, plane.y!] : [plane.y!, plane.x];
  const row = (values: number[], k: number) => along.points.map((_, i) => values[overX ? i * ny + k : k * ny + i]!);
  const count = across.points.length;
  const every = Math.max(1, Math.ceil(count / 10));
  const chosen = across.points.map((_, k) => k).filter((k) => k % every === 0 || k === count - 1);
  const share = (k: number) => (count > 1 ? k / (count - 1) : 0);
  const ghosts = changed ? chosen.map((k) => lineLayer("edge", along.points, row(before, k), { width: 0.9 })) : [];
  const lines = chosen.map((k) => ({ ...familyLayer(share(k), along.points, row(after, k)), at: k }));
  host.append(
    make(
      "div",
      { class: "legend tight" },
      make("span", {}, `${withUnit(across.title, across.unit)}:`),
      ...chosen.map((k) =>
        make(
          "span",
          { class: "key" },
          swatch(`light-dark(${css(family(share(k), false))}, ${css(family(share(k), true))})`),
          plain(across.points[k]!, 4),
        ),
      ),
      changed ? make("span", { class: "hint" }, "before in grey") : null,
    ),
  );
  new Chart(host, [{ title: withUnit(f.name, f.unit), layers: [...ghosts, ...lines] }], {
    height: (width) => Math.max(240, Math.min(380, width * 0.68)),
    fixed: true,
    legend: false,
    title: withUnit(along.title, along.unit),
    margin: 0.02,
    tip(value, plot, _px, py) {
      const i = nearest(along.points, value);
      const distance = (layer: Points) => Math.abs(plot.y(layer.y[i]!) - py);
      const line = lines.reduce((best, each) => (distance(each) < distance(best) ? each : best));
      if (!(distance(line) < 24)) return null;
      const places = [
        `${along.title} ${plain(along.points[i]!, 6)}`,
        `${across.title} ${plain(across.points[line.at]!, 6)}`,
      ];
      return {
        x: along.points[i],
        lines: [[places[0]!], [places[1]!], [`${plain(line.y[i]!, 6)} ${f.unit}`, css(family(share(line.at)))]],
      };
    },
  });
}

/** A curve before and after, twice its standard deviation on both sides, and the samples at its points. */
export function drawCurve(host: HTMLElement, plane: Plane): void {
  const { f, changed } = plane;
  const overX = plane.nx > 1 || plane.y === null;
  const axis = overX ? plane.x : plane.y!;
  const x = axis.points;
  const after = numbers(plane.pick(f.after));
  const samples = f.samples && plane.pick(f.samples);
  const layers: Layer[] = f.deviation ? uncertainty(x, after, plane.pick(f.deviation)) : [];
  if (changed)
    layers.push(lineLayer("before", x, numbers(plane.pick(f.before)), { name: "before", width: 1.4, dots: 2.2 }));
  layers.push(
    lineLayer("model", x, after, {
      name: changed ? "after" : "value",
      width: 1.8,
      dots: 2.8,
      hollow: samples?.map((count) => count === 0),
    }),
  );
  const panes: Pane[] = [{ title: withUnit(f.name, f.unit), weight: 3, layers }];
  if (samples)
    panes.push({ title: "samples", scale: "counts", zero: true, layers: [stemsLayer("edge", x, samples, 5)] });
  new Chart(host, panes, {
    height: () => 300,
    fixed: true,
    title: withUnit(axis.title, axis.unit),
    margin: 0.03,
    tip(value) {
      const k = nearest(x, value);
      return { x: x[k], lines: plane.describe(overX ? k : 0, overX ? 0 : k) };
    },
  });
}

function uncertainty(x: number[], after: number[], deviation: (number | null)[]): Layer[] {
  const wide = deviation.map((value) => (value !== null && value >= 0 ? 2 * value : NaN));
  const open = x.filter((_, k) => deviation[k] === -1);
  const side = (sign: number) => after.map((value, k) => value + sign * wide[k]!);
  const band = bandLayer("model", x, side(1), side(-1), 0.15, "± 2 standard deviations");
  return open.length ? [uprightLayer("warn", open, [3, 3], "not determined"), band] : [band];
}
