// Measured and calculated against each other, and the distribution and memory of the errors.

import { extent, widened } from "../drawing/canvas";
import { plain, withUnit } from "../drawing/numbers";
import { nearest } from "../drawing/strips";
import { Chart, type Tip } from "./chart";
import { make, type TipLine } from "./elements";
import {
  type AutocorrelationFigure,
  type Bins,
  equal,
  type HistogramsFigure,
  numbers,
  type ScatterFigure,
} from "./figures";
import {
  bandLayer,
  barsLayer,
  diagonalLayer,
  dotsLayer,
  type Layer,
  levelLayer,
  lineLayer,
  uprightLayer,
} from "./layers";
import { nearestPoint } from "./nearest-point";

export function drawScatter(host: HTMLElement, f: ScatterFigure): void {
  const [measured, before, after] = [numbers(f.measured), numbers(f.before), numbers(f.after)];
  const same = equal(f.before, f.after);
  const radius = measured.length > 800 ? 1.5 : 2.2;
  const points = [
    ...(same ? [] : [dotsLayer("before", "before", measured, before, radius, 0.65)]),
    dotsLayer("model", same ? "model" : "after", measured, after, radius, 0.7),
  ];
  const range = widened(extent(measured, after, same ? after : before), 0.04);
  new Chart(host, [{ title: withUnit("calculated", f.unit), layers: [diagonalLayer("axis"), ...points], range }], {
    height: () => 300,
    fixed: true,
    title: withUnit("measured", f.unit),
    range: widened(extent(measured, after), 0.04),
    tip(_value, plot, px, py, shown) {
      const hit = nearestPoint(points.filter(shown), plot, px, py, 14);
      if (hit === null) return null;
      const [layer, k] = hit;
      const [x, y] = [layer.x[k]!, layer.y[k]!];
      return {
        lines: [
          [`sample ${f.number[k]}`],
          [`measured ${plain(x, 5)}`],
          [`${layer.name} ${plain(y, 5)}`, layer.colour],
          [`error ${plain(y - x, 4)}`, "error"],
        ],
      };
    },
  });
}

interface Histogram {
  name: string;
  bins: Bins;
  colour: string;
  opacity?: number;
}

export function drawHistograms(host: HTMLElement, f: HistogramsFigure): void {
  const { before, after } = f.own;
  const same = equal(before.counts, after.counts) && equal(before.ends, after.ends);
  const beyond = (bins: Bins) => (bins.beyond ? `, ${bins.beyond} beyond the ends` : "");
  const title = withUnit("error", f.unit);
  const grid = make("div", { class: "three" });
  host.append(grid);
  if (same) {
    addHistogram(grid, title + beyond(after), title, "wide", [{ name: "error", bins: after, colour: "model" }]);
    return;
  }
  addHistogram(grid, `before${beyond(before)}`, "", "", [{ name: "before", bins: before, colour: "before" }]);
  addHistogram(grid, `after${beyond(after)}`, "", "", [{ name: "after", bins: after, colour: "model" }]);
  const both = [
    { name: "after", bins: f.equal.after, colour: "model", opacity: 0.75 },
    { name: "before", bins: f.equal.before, colour: "before", opacity: 0.8 },
  ];
  addHistogram(grid, "both on one axis", title, "wide", both);
}

function addHistogram(grid: HTMLElement, heading: string, title: string, kind: string, parts: Histogram[]): void {
  const cell = make("div", { class: kind }, make("div", { class: "heading" }, heading));
  grid.append(cell);
  const bars: Layer[] = parts.map((part) =>
    barsLayer(part.colour, part.name, part.bins.ends, part.bins.counts, part.opacity),
  );
  new Chart(
    cell,
    [{ title: "samples", scale: "counts", zero: true, layers: [...bars, uprightLayer("axis", [0], [2, 2])] }],
    {
      height: () => 146,
      left: 54,
      fixed: true,
      legend: false,
      title,
      tip: (value) => binTip(parts, value),
    },
  );
}

function binTip(parts: Histogram[], value: number): Tip | null {
  const lines = parts
    .filter(({ bins: { ends } }) => value >= ends[0] && value <= ends[1])
    .map<TipLine>(({ name, bins: { ends, counts }, colour }) => {
      const wide = (ends[1] - ends[0]) / counts.length;
      const k = Math.min(counts.length - 1, Math.floor((value - ends[0]) / wide));
      return [
        `${name}: ${counts[k]} from ${plain(ends[0] + k * wide, 3)} to ${plain(ends[0] + (k + 1) * wide, 3)}`,
        colour,
      ];
    });
  return lines.length ? { lines } : null;
}

export function drawAutocorrelation(host: HTMLElement, f: AutocorrelationFigure): void {
  const y = numbers(f.values);
  const ends = [f.lags[0]!, f.lags[f.lags.length - 1]!];
  const noise = bandLayer("before", ends, [f.band, f.band], [-f.band, -f.band], 0.3);
  const layers = [noise, levelLayer("axis", [0]), lineLayer("error", f.lags, y, { width: 1.4 })];
  new Chart(host, [{ title: "correlation", range: [Math.min(-0.15, extent(y)[0] * 1.1), 1.05], layers }], {
    height: () => 190,
    title: f.unit === "s" ? "later by [s]" : "later by [samples]",
    tip(value) {
      const k = nearest(f.lags, value);
      return {
        x: f.lags[k],
        lines: [[`${plain(f.lags[k]!, 5)} ${f.unit} later`], [`correlation ${plain(y[k]!, 3)}`, "error"]],
      };
    },
  });
}
