// The cost over the accepted steps of a search, by stage.

import { plain } from "../drawing/numbers";
import { Chart } from "./chart";
import { type ConvergenceFigure, numbers, type Stage } from "./figures";
import { levelLayer, lineLayer, type Points } from "./layers";
import { nearestPoint } from "./nearest-point";

const SMOOTHED = ["#ecaa5a", "#dd8d50", "#ce6f46", "#c4573f", "#b44e58", "#a24668", "#8f3f73", "#a0559a"];

type StageLayer = Points & { stage: Stage };

export function drawConvergence(host: HTMLElement, f: ConvergenceFigure): void {
  const several = new Set(f.stages.map((stage) => stage.start)).size > 1;
  let smoothed = 0;
  const colourOf = ({ name }: Stage): string => {
    const kind = name.split(" ")[0];
    return kind === "plain" ? "measured" : kind === "exact" ? "model" : SMOOTHED[smoothed++ % SMOOTHED.length]!;
  };
  const layers = f.stages.map<StageLayer>((stage) => {
    const name = several ? `${stage.name}, start ${stage.start}` : stage.name;
    return { ...lineLayer(colourOf(stage), stage.x, numbers(stage.cost), { name, width: 1.4, dots: 1.8 }), stage };
  });
  const before =
    f.before !== null && f.before > 0
      ? [levelLayer("before", [f.before], { name: "before", dash: [4, 3], reach: [f.before] })]
      : [];
  new Chart(host, [{ title: "cost", scale: "log", layers: [...before, ...layers] }], {
    height: () => 280,
    legend: layers.length < 24,
    title: "accepted step",
    margin: 0.02,
    whole: true,
    tip(_value, plot, px, py, shown) {
      const hit = nearestPoint(layers.filter(shown), plot, px, py, 16);
      if (hit === null) return null;
      const [layer, k] = hit;
      return {
        lines: [
          [layer.name!, layer.colour],
          [`step ${layer.x[k]}`],
          [`cost ${plain(layer.y[k]!, 6)}`],
          [`RMSE ${plain(layer.stage.rmse[k] ?? NaN, 4)}`],
        ],
      };
    },
  });
}
