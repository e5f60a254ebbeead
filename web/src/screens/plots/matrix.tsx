// The scatter matrix: each chosen signal over each other one, its distribution on the diagonal.

import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { type Area, area, canvasIn, extent, type Pen, ticks, widened } from "../../drawing/canvas";
import { token } from "../../drawing/colours";
import { brushing, drawCursor, drawDots, drawRectangle, within } from "../../instruments/scatter";
import { type Points, points, sample } from "../../plot-data";
import { brush, cursor, keyOf } from "../../plots";
import type { SignalName } from "../../replies";
import { theme } from "../../store";
import { matrixSignals, nameOf, searching, setMatrix, titleOf } from "../../strip-rows";

interface Cell {
  plot: Area;
  x: SignalName;
  y: SignalName;
  xs: Float32Array;
  ys: Float32Array;
}

export function Matrix() {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  useLayoutEffect(() => {
    let cells: Cell[] = [];
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, wide, high) => {
      cells = points.value === null ? [] : draw(pen, wide, high, points.value);
    });
    redraw.current = again;
    brushing(canvas, (x, y) => {
      const cell = cells.find((each) => within(each.plot, x, y));
      const data = points.value;
      if (cell === undefined || data === null) return null;
      return {
        plot: cell.plot,
        props: {
          signals: [cell.x, cell.y],
          x: cell.xs,
          clouds: [{ y: cell.ys, colour: "model" }],
          position: data.position,
          begin: data.begin,
        },
      };
    });
    return close;
  }, []);
  useEffect(
    () => redraw.current(),
    [points.value, matrixSignals.value, brush.value, cursor.value, sample.value, theme.value],
  );
  return (
    <section class="pane matrix" aria-label="Scatter matrix">
      <div class="head">
        <h2>Scatter matrix</h2>
        {matrixSignals.value.map((each) => (
          <button
            class="chip"
            title={`Take ${nameOf(each)} out of the matrix`}
            onClick={() => setMatrix(matrixSignals.value.filter((other) => keyOf(other) !== keyOf(each)))}
          >
            {nameOf(each)} <i>×</i>
          </button>
        ))}
        <button
          class="btn bare small"
          title="Add a signal (S)"
          onClick={() => {
            searching.value = true;
          }}
        >
          + Signal
        </button>
      </div>
      {matrixSignals.value.length < 2 && (
        <p class="pad q">A matrix needs two signals. Add them from the list of signals (S).</p>
      )}
      <div class="body canvas" ref={host} aria-label="Scatter matrix; drag a rectangle to brush, click for a sample" />
    </section>
  );
}

function draw(pen: Pen, width: number, height: number, data: Points): Cell[] {
  const shown = matrixSignals.value
    .map((signal) => ({ signal, values: data.values[data.signals.findIndex((each) => keyOf(each) === keyOf(signal))] }))
    .filter((each): each is { signal: SignalName; values: Float32Array } => each.values !== undefined);
  const n = shown.length;
  if (n < 2) return [];
  const [left, bottom] = [52, 20];
  const [wide, high] = [(width - left - 12) / n, (height - bottom - 8) / n];
  const ranges = shown.map(({ values }) => widened(extent(values), 0.05));
  const cells: Cell[] = [];
  shown.forEach((y, j) =>
    shown.forEach((x, i) => {
      const box = {
        left: left + i * wide,
        right: left + (i + 1) * wide - 6,
        top: 8 + j * high,
        bottom: 8 + (j + 1) * high - 6,
      };
      const few = (range: readonly [number, number], pixels: number) => ticks(...range, Math.max(2, pixels / 70));
      const plot = area(pen, box, ranges[i]!, ranges[j]!, {
        xTicks: few(ranges[i]!, wide),
        yTicks: few(ranges[j]!, high),
        unlabelled: j < n - 1,
        unlabelledY: i > 0 || j === 0,
      });
      if (i === j) drawDistribution(pen, plot, x.values, data.lit, titleOf(x.signal));
      else {
        plot.clip(() => {
          drawDots(
            pen,
            plot,
            x.values,
            y.values,
            token(y.signal.kind.includes("error") ? "error" : "model"),
            null,
            1.4,
          );
          drawDots(pen, plot, x.values, y.values, token("lit"), data.lit, 2.2);
          drawRectangle(pen, plot, brush.value, [x.signal, y.signal]);
          drawCursor(pen, plot, [x.signal, y.signal]);
        });
        cells.push({ plot, x: x.signal, y: y.signal, xs: x.values, ys: y.values });
      }
    }),
  );
  return cells;
}

const BINS = 24;

/** How many of the drawn samples have which value; the lit ones in front. */
function drawDistribution(pen: Pen, plot: Area, values: Float32Array, lit: Float32Array, title: string): void {
  const { left, right, top, bottom } = plot.box;
  const counts = [new Float64Array(BINS), new Float64Array(BINS)];
  const step = (right - left) / BINS;
  for (let k = 0; k < values.length; k++) {
    const at = Math.floor((plot.x(values[k]!) - left) / step);
    if (!(at >= 0 && at < BINS)) continue;
    counts[0]![at]! += 1;
    if (lit[k]! > 0) counts[1]![at]! += 1;
  }
  const most = Math.max(1, ...counts[0]!) / 0.72;
  plot.clip(() =>
    counts.forEach((own, which) => {
      pen.fillStyle = token(which ? "lit" : "before");
      own.forEach((value, k) =>
        pen.fillRect(
          left + k * step + 0.5,
          bottom - ((bottom - top) * value) / most,
          step - 1,
          ((bottom - top) * value) / most,
        ),
      );
    }),
  );
  pen.fillStyle = token("ink");
  pen.textBaseline = "top";
  pen.textAlign = "left";
  pen.fillText(title, left + 6, top + 5, right - left - 10);
}
