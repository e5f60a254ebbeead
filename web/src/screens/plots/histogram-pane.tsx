// The errors of a criterion as a histogram, now and at the start; a brushed interval lights up its samples.

import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { type Area, area, canvasIn, line, type Pen } from "../../drawing/canvas";
import { token } from "../../drawing/colours";
import { count, counted, plain, unitText, withUnit } from "../../drawing/numbers";
import { lastUpTo } from "../../drawing/strips";
import { tipOn } from "../../hover-tip";
import { drawRectangle, rangeOf } from "../../instruments/scatter";
import { WhatIsMissing } from "../../instruments/what-is-missing";
import { both, scatter } from "../../plot-data";
import { brush, criterion, criterionNumber, part } from "../../plots";
import type { ScatterArrays, SignalName } from "../../replies";
import { theme } from "../../store";

export function HistogramPane() {
  return (
    <section class="pane hi" aria-label="Errors">
      <div class="head">
        <h2>Errors</h2>
        <span class="right">
          <WhatIsMissing />
          <span class="seg tight" role="group" aria-label="Histograms">
            <button
              aria-pressed={!both.value}
              onClick={() => {
                both.value = false;
              }}
            >
              now
            </button>
            <button
              aria-pressed={both.value}
              onClick={() => {
                both.value = true;
              }}
            >
              start and now
            </button>
          </span>
        </span>
      </div>
      <Histogram />
    </section>
  );
}

const error = (): SignalName => ({ kind: "error", name: String(criterionNumber.value) });

function Histogram() {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  useLayoutEffect(() => {
    let plot: Area | null = null;
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, wide, high) => {
      plot = scatter.value === null ? null : draw(pen, wide, high, scatter.value);
    });
    redraw.current = again;
    listen(canvas, () => plot);
    const silence = tipOn(canvas, (x) =>
      plot === null || scatter.value === null ? null : binTip(plot, scatter.value, x),
    );
    return () => {
      silence();
      close();
    };
  }, []);
  useEffect(() => redraw.current(), [scatter.value, both.value, brush.value, theme.value]);
  return <div class="body canvas" ref={host} aria-label="Histogram of the errors; drag to brush an interval" />;
}

/** Drag sideways to brush the samples with these errors. */
function listen(canvas: HTMLCanvasElement, area: () => Area | null): void {
  let from: number | null = null;
  const at = (event: PointerEvent) => event.clientX - canvas.getBoundingClientRect().left;
  canvas.style.cursor = "crosshair";
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    from = at(event);
  };
  canvas.onpointermove = (event) => {
    const plot = area();
    if (from === null || plot === null || Math.abs(at(event) - from) < 3) return;
    brush.value = { ranges: [rangeOf(error(), from, at(event), plot.box.left, plot.box.right, plot.x)] };
    part.value = "point";
  };
  canvas.onpointerup = () => {
    from = null;
  };
}

function draw(pen: Pen, width: number, height: number, data: ScatterArrays): Area {
  const box = { left: 52, right: width - 14, top: 8, bottom: height - 34 };
  const shown = both.value
    ? ([
        [data.before, "before"],
        [data.after, "model"],
      ] as const)
    : ([[data.after, "model"]] as const);
  const most = Math.max(1, ...shown.flatMap(([values]) => [...values]));
  const ends = [data.edges[0]!, data.edges[data.edges.length - 1]!] as const;
  const plot = area(pen, box, ends, [0, most * 1.06], { title: withUnit("error", criterion.value?.unit ?? "") });
  plot.clip(() => {
    for (const [values, colour] of shown) {
      pen.fillStyle = token(colour);
      pen.globalAlpha = both.value ? 0.7 : 1;
      values.forEach((value, k) =>
        pen.fillRect(
          plot.x(data.edges[k]!) + 0.5,
          plot.y(value),
          plot.x(data.edges[k + 1]!) - plot.x(data.edges[k]!) - 1,
          plot.y(0) - plot.y(value),
        ),
      );
      pen.globalAlpha = 1;
    }
    line(pen, [plot.x(0), plot.x(0)], [box.top, box.bottom], token("ink"), 0.75);
    drawBeyond(pen, plot, data);
    drawBrushed(pen, plot, data, most);
    drawRectangle(pen, plot, brush.value, [error(), { kind: "node", name: "" }]);
  });
  return plot;
}

/** How many errors are in the bin at a pixel. */
function binTip(plot: Area, data: ScatterArrays, x: number): string[] | null {
  const value = plot.xAt(x);
  const k = lastUpTo(data.edges, value);
  if (!(value >= data.edges[0]!) || k >= data.after.length) return null;
  const ends = `${plain(data.edges[k]!, 3)} … ${plain(data.edges[k + 1]!, 3)} ${unitText(criterion.value?.unit ?? "")}`;
  return [
    counted(data.after[k]!, "sample"),
    ...(both.value ? [`start ${count(data.before[k]!)}`] : []),
    `error ${ends}`.trim(),
  ];
}

/** How many errors lie beyond the ends, which the end bins hold. */
function drawBeyond(pen: Pen, plot: Area, data: ScatterArrays): void {
  const [below = 0, above = 0] = data.beyond;
  pen.fillStyle = token("quiet");
  pen.textBaseline = "top";
  pen.textAlign = "left";
  if (below > 0) pen.fillText(`${count(below)} below`, plot.box.left + 5, plot.box.top + 4);
  pen.textAlign = "right";
  if (above > 0) pen.fillText(`${count(above)} above`, plot.box.right - 5, plot.box.top + 4);
}

/** The outline of the brushed samples, scaled to two thirds of the height. */
function drawBrushed(pen: Pen, plot: Area, data: ScatterArrays, most: number): void {
  const greatest = Math.max(0, ...data.brushed);
  if (greatest === 0) return;
  const scaled = greatest < most / 3;
  const factor = scaled ? (0.66 * most) / greatest : 1;
  const xs = [...data.brushed].flatMap((_, k) => [plot.x(data.edges[k]!), plot.x(data.edges[k + 1]!)]);
  line(
    pen,
    xs,
    [...data.brushed].flatMap((value) => [plot.y(value * factor), plot.y(value * factor)]),
    token("lit"),
    1.8,
  );
  pen.fillStyle = token("lit-text");
  pen.textAlign = "right";
  pen.textBaseline = "top";
  pen.fillText(scaled ? "brushed, scaled" : "brushed", plot.box.right - 6, plot.box.top + 6);
}
