// The plots: strips over time, calculated over measured, errors, and the grid points that a brushed stretch passes.

import { computed, signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { area, extent, widened, type Pen } from "../drawing/canvas";
import { css, height as heightColour, token } from "../drawing/colours";
import { count, fixed, significant, signed } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { Picture } from "../instruments/picture";
import { Overview, Strips } from "../instruments/strips";
import { back, both, brush, brushed, cursor, dataset, datasetNumber, range, scatter, stretch, visible, zoom, type Stretch } from "../plots";
import { setKeys, valueAt } from "../settings";
import { openName, state, table } from "../store";

export const tool = signal<"zoom" | "range" | "brush">("zoom");

export function Plots() {
  useEffect(() => {
    addEventListener("keydown", key);
    return () => removeEventListener("keydown", key);
  }, []);
  const { begin, end } = visible.value;
  const own = dataset.value;
  return (
    <>
      <main class="plots">
        <section class="pane tool">
          <div class="head">
            <select class="field small" aria-label="Dataset" value={datasetNumber.value} onChange={(event) => { datasetNumber.value = Number(event.currentTarget.value); stretch.value = brush.value = range.value = null; }}>
              {state.value.datasets.map((each, k) => <option value={k}>{each.name} · {each.use}</option>)}
            </select>
            <span class="sep" />
            <span class="seg tight">{(["zoom", "range", "brush"] as const).map((name) => <button aria-pressed={tool.value === name} onClick={() => { tool.value = name; }}>{name[0]!.toUpperCase() + name.slice(1)}</button>)}</span>
            <button class="btn small" onClick={back}>Back</button>
            <button class="btn small" onClick={() => zoom(null)}>Whole</button>
            <span class="sep" />
            <span class="ink">{fixed(begin, 1)} … {fixed(end, 1)}{own?.timed ? " s" : ""}</span>
            <span class="right">
              {(["measured", "model", "before", "error"] as const).map((name) => <span class="key"><i style={{ borderColor: `var(--${name})` }} />{{ measured: "measured", model: "now", before: "start", error: "error" }[name]}</span>)}
            </span>
          </div>
        </section>
        <section class="pane strip-pane">
          <div class="ov"><div class="leg"><span class="q">whole {own?.name}</span></div><Overview /></div>
          <Strips />
          <BrushBar />
        </section>
        <section class="pane sc"><div class="head"><h2>Calculated over measured</h2><span class="right q">{state.value.criteria[0]?.unit}</span></div><Picture label="Calculated over measured" kind="body" draw={drawScatter} of={[scatter.value]} /></section>
        <section class="pane hi"><div class="head"><h2>Errors</h2><span class="right"><span class="seg tight"><button aria-pressed={!both.value} onClick={() => { both.value = false; }}>now</button><button aria-pressed={both.value} onClick={() => { both.value = true; }}>start and now</button></span></span></div><Picture label="Histogram of the errors" kind="body" draw={drawHistogram} of={[scatter.value, both.value]} /></section>
        <section class="pane mp"><div class="head"><h2>{openName.value}</h2><span class="sub">points the stretch passes</span><span class="right q">{passedText.value}</span></div><Picture label="Grid points passed" kind="body" draw={drawPassed} of={[brushed.value, table.value]} /></section>
      </main>
      <Footer>
        <Key keys={["← →"]} text="move" /><Key keys={["R"]} text="range" /><Key keys={["B"]} text="brush" /><Key keys={["W"]} text="whole" /><Key keys={["Backspace"]} text="back" /><Key keys={["Esc"]} text="no selection" />
      </Footer>
    </>
  );
}

const passedText = computed(() => {
  const weights = brushed.value?.weights[openName.value];
  return weights ? `${weights.filter((w) => w > 0).length} of ${weights.length}` : "";
});

function BrushBar() {
  const part = brush.value;
  const numbers = brushed.value;
  if (part === null || numbers === null) return null;
  const unit = state.value.criteria[0]?.unit ?? "";
  return (
    <div class="foot">
      <span class="lit"><b>Brushed {fixed(part.begin, 1)} … {fixed(part.end, 1)}{dataset.value?.timed ? " s" : ""}</b></span>
      <span>{count(numbers.samples)} samples</span>
      <span class="q">RMSE</span><span class="ink">{significant(numbers.rmse)} {unit}</span>
      <span class="q">mean error</span><span class="ink">{signed(numbers.mean)}</span>
      <span class="right">
        <button class="btn small" disabled={!conditional()} title={conditional() ? "where = ..." : "only for a single recording with time stamps"} onClick={() => limitTo(part, true)}>Only these</button>
        <button class="btn small" disabled={!conditional()} onClick={() => limitTo(part, false)}>Leave out</button>
      </span>
    </div>
  );
}

const conditional = (): boolean => dataset.value?.timed === true && dataset.value.pieces.length === 0;

/** Score only the samples of a stretch, or all but these; an existing condition stays. */
function limitTo(part: Stretch, inside: boolean): void {
  const path = ["dataset", datasetNumber.value + 1, "where"];
  const [a, b] = [part.begin, part.end].map((at) => Number((at - dataset.value!.begin).toPrecision(8)));
  const own = inside ? `t >= ${a} and t <= ${b}` : `(t < ${a} or t > ${b})`;
  const before = valueAt(path);
  const condition = typeof before === "string" && before ? `(${before}) and ${own}` : own;
  void setKeys([[path, condition]], inside ? "Only the brushed stretch is scored" : "The brushed stretch is left out");
}

function key(event: KeyboardEvent): void {
  if (event.ctrlKey || event.metaKey || event.altKey || (event.target as HTMLElement).closest("input,select,textarea")) return;
  const { begin, end } = visible.value;
  const wide = end - begin;
  const actions: Record<string, () => void> = {
    r: () => { tool.value = "range"; },
    b: () => { tool.value = "brush"; },
    z: () => { tool.value = "zoom"; },
    w: () => zoom(null),
    Backspace: back,
    Escape: () => { brush.value = range.value = cursor.value = null; },
    ArrowLeft: () => zoom({ begin: begin - wide / 10, end: end - wide / 10 }),
    ArrowRight: () => zoom({ begin: begin + wide / 10, end: end + wide / 10 }),
    ArrowUp: () => zoom({ begin: begin + wide / 8, end: end - wide / 8 }),
    ArrowDown: () => zoom({ begin: begin - wide / 6, end: end + wide / 6 }),
  };
  const action = actions[event.key] ?? actions[event.key.toLowerCase()];
  if (action === undefined) return;
  event.preventDefault();
  action();
}

function drawScatter(pen: Pen, width: number, height: number): void {
  const data = scatter.value;
  if (data === null) return;
  const box = { left: 44, right: width - 14, top: 10, bottom: height - 36 };
  const reach = widened(extent(data.measured, data.now), 0.04);
  const plot = area(pen, box, reach, reach, { title: "measured" });
  plot.clip(() => {
    for (const [values, colour] of [[data.start, "before"], [data.now, "model"]] as const) {
      pen.fillStyle = token(colour);
      for (let k = 0; k < values.length; k++) pen.fillRect(plot.x(data.measured[k]!) - 0.9, plot.y(values[k]!) - 0.9, 1.8, 1.8);
    }
    pen.strokeStyle = token("axis");
    pen.setLineDash([4, 3]);
    pen.beginPath();
    pen.moveTo(plot.x(reach[0]), plot.y(reach[0]));
    pen.lineTo(plot.x(reach[1]), plot.y(reach[1]));
    pen.stroke();
    pen.setLineDash([]);
  });
}

function drawHistogram(pen: Pen, width: number, height: number): void {
  const data = scatter.value;
  if (data === null) return;
  const box = { left: 44, right: width - 14, top: 8, bottom: height - 34 };
  const most = Math.max(1, ...data.after, ...(both.value ? data.before : []));
  const plot = area(pen, box, [data.edges[0]!, data.edges[data.edges.length - 1]!], [0, most * 1.06], { title: `error [${state.value.criteria[0]?.unit ?? ""}]` });
  plot.clip(() => {
    for (const [values, colour] of both.value ? ([[data.before, "before"], [data.after, "model"]] as const) : ([[data.after, "model"]] as const)) {
      pen.fillStyle = token(colour);
      pen.globalAlpha = both.value ? 0.7 : 1;
      values.forEach((value, k) => pen.fillRect(plot.x(data.edges[k]!) + 0.5, plot.y(value), plot.x(data.edges[k + 1]!) - plot.x(data.edges[k]!) - 1, plot.y(0) - plot.y(value)));
      pen.globalAlpha = 1;
    }
  });
}

function drawPassed(pen: Pen, width: number, height: number): void {
  const own = table.value;
  if (own === null || own.axes.length !== 2) return;
  const [xs, ys] = [own.axes[0]!.points, own.axes[1]!.points];
  const box = { left: 44, right: width - 14, top: 8, bottom: height - 34 };
  const [w, h] = [(box.right - box.left) / xs.length, (box.bottom - box.top) / ys.length];
  const [low, high] = extent(own.values);
  const weights = brushed.value?.weights[own.name];
  const most = weights ? Math.max(...weights, 1e-9) : 1;
  own.values.forEach((value, k) => {
    const [i, j] = [Math.floor(k / ys.length), k % ys.length];
    const [x, y] = [box.left + i * w, box.bottom - (j + 1) * h];
    pen.fillStyle = css(heightColour(high > low ? (value - low) / (high - low) : 0.5), 0.45);
    pen.fillRect(x, y, w - 1, h - 1);
    const weight = weights?.[k] ?? 0;
    if (weight <= 0) return;
    pen.fillStyle = token("lit");
    pen.beginPath();
    pen.arc(x + w / 2, y + h / 2, 1.5 + (Math.min(w, h) / 2 - 2) * Math.sqrt(weight / most), 0, 7);
    pen.fill();
  });
  pen.fillStyle = token("quiet");
  pen.textAlign = "right";
  pen.fillText(own.axes.map((axis) => (axis.unit ? `${axis.input} [${axis.unit}]` : axis.input)).join(", "), box.right, height - 6);
  pen.textBaseline = "middle";
  ys.forEach((value, j) => { if (j % Math.ceil(ys.length / 6) === 0) pen.fillText(significant(value, 3), box.left - 5, box.bottom - (j + 0.5) * h); });
  pen.textBaseline = "top";
  pen.textAlign = "center";
  xs.forEach((value, i) => { if (i % Math.ceil(xs.length / 5) === 0) pen.fillText(significant(value, 4), box.left + (i + 0.5) * w, box.bottom + 4); });
}
