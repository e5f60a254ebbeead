// What a grid point rests on: its samples, their errors, where they look the table up, and when.

import { batch, computed, effect, signal } from "@preact/signals";
import { newest } from "../connection";
import { area, extent, line, widened, type Pen } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { count, plain, signed, significant } from "../drawing/numbers";
import { brush, chooseCriterion, criterion, criterionNumber, showDataset, stretch } from "../plots";
import { endDrag, referenceName, request, revision, screen, selection, setValues, settled, state, table, type Table } from "../store";
import { cellAt } from "./map-table";
import { Picture } from "./picture";

interface Part { number: number; dataset: string; samples: number; count: number; stretches: [number, number][]; meanBefore: number | null; meanNow: number | null }
interface Evidence { name: string; cell: number; parts: Part[]; most: number; x: Float32Array; y: Float32Array; weight: Float32Array }
interface Strip { begin: number; x: Float32Array; measured: Float32Array; now: Float32Array }

const evidence = signal<Evidence | null>(null);
const shownStretch = signal(0);
const strip = signal<Strip | null>(null);

const load = newest(async (given: { name: string; cell: number; criterion: number }) => {
  const reply = await request("informing", given);
  if (reply === null) return;
  const { x, y, weight } = reply.arrays;
  const next = { name: given.name, cell: given.cell, parts: reply.head.datasets as Part[], most: (reply.head.most as number) ?? 0, x: x ?? new Float32Array(), y: y ?? new Float32Array(), weight: weight ?? new Float32Array() };
  batch(() => {
    if (next.name !== evidence.value?.name || next.cell !== evidence.value.cell) shownStretch.value = 0;
    evidence.value = next;
  });
});

const loadStrip = newest(async ([dataset, from, to]: [number, number, number]) => {
  const number = String(criterionNumber.value);
  const pause = Math.max((to - from) * 1.5, 4);
  const [begin, end] = [from - pause, to + pause];
  const node = criterion.value?.node ?? "";
  const reply = await request("strip", { dataset, begin, end, pixels: 240, signals: [{ kind: "target", name: number }, { kind: "node", name: node }] });
  if (reply !== null) strip.value = { begin: reply.head.begin as number, x: reply.arrays.x!, measured: reply.arrays["0"]!, now: reply.arrays["1"]! };
});

const name = computed(() => table.value?.name ?? "");
const cell = computed(() => {
  const own = table.value;
  return own === null || own.axes.length === 0 ? -1 : cellAt(own, ...selection.value.active);
});

effect(() => {
  void revision.value;
  if (screen.value === "parameters" && cell.value >= 0) load({ name: name.value, cell: cell.value, criterion: criterionNumber.value });
});

const shownPart = computed(() => evidence.value?.parts.find((each) => each.number === evidence.value!.most));

/** Dataset, begin and end of the shown stretch; as text, so that an equal one counts as the same. */
const place = computed(() => {
  const ends = shownPart.value?.stretches[shownStretch.value];
  return ends === undefined ? "" : [shownPart.value!.number, ...ends].join(" ");
});

effect(() => {
  void [revision.value, criterionNumber.value];
  if (place.value === "") strip.value = null;
  else if (screen.value === "parameters") loadStrip(place.value.split(" ").map(Number) as [number, number, number]);
});

export function EvidencePane({ own }: { own: Table }) {
  const cell = cellAt(own, ...selection.value.active);
  const data = evidence.value;
  const part = shownPart.value;
  const total = data?.parts.reduce((sum, each) => sum + each.samples, 0) ?? 0;
  const deviation = own.deviation?.[cell];
  const how = own.locked.includes(cell) ? "locked" : own.values[cell] !== own.reference[cell] && !state.value.runs.length ? "by hand" : own.samples?.[cell] === 0 ? "no data" : "data";
  return (
    <section class="pane evid" aria-label="Evidence">
      <div class="head"><h2>What this point rests on</h2><span class="right">{settled.value.criteria.length > 1 && <select class="field small" aria-label="Criterion" title="The criterion whose errors are shown" value={criterionNumber.value} onChange={(event) => chooseCriterion(Number(event.currentTarget.value))}>{settled.value.criteria.map((each, k) => <option value={k}>{each.node}</option>)}</select>}<span class={`tag ${how === "data" ? "g" : "w"}`}>{how}</span></span></div>
      <dl class="facts facts3">
        <dt>grid point</dt><dd>{own.axes.map((axis, k) => <>{k > 0 && ", "}{plain(axis.points[selection.value.active[k]!] ?? 0, 5)} <u>{axis.unit}</u></>)}</dd>
        <dt>now</dt><dd><b>{significant(own.values[cell]!, 5)}</b> <u>{own.unit}</u></dd>
        <dt>{referenceName.value}, difference</dt><dd>{significant(own.reference[cell]!, 5)}, {signed(own.values[cell]! - own.reference[cell]!, 4)}</dd>
        <dt>standard deviation</dt><dd>{deviation === undefined ? "after a run" : deviation === null ? "undetermined" : `± ${significant(deviation, 3)}`}</dd>
        <dt>samples</dt><dd>{count(total)} <u>in</u> {count(data?.parts.reduce((sum, each) => sum + each.count, 0) ?? 0)} <u>stretches</u></dd>
        <dt>their mean error</dt><dd>{part ? <>{signed(part.meanBefore ?? NaN)} → <b>{signed(part.meanNow ?? NaN)}</b></> : "–"}</dd>
      </dl>
      <div class="sub2"><b>In the {own.kind}</b><span class="key"><i class="dot" style={{ background: "var(--lit)" }} />its samples</span><span class="key"><i class="dot" style={{ background: "var(--before)" }} />others</span></div>
      <Picture label="Samples around the grid point" kind="near" draw={drawNear} of={[evidence.value, selection.value, own]} />
      <div class="sub2">
        <b>In {part?.dataset ?? "the data"}</b><span class="q">{part ? `${shownStretch.value + 1} of ${part.stretches.length}, longest first` : ""}</span>
        <span class="right"><button class="btn bare small" aria-label="Previous stretch" disabled={shownStretch.value === 0} onClick={() => { shownStretch.value -= 1; }}>‹</button><button class="btn bare small" aria-label="Next stretch" disabled={!part || shownStretch.value + 1 >= part.stretches.length} onClick={() => { shownStretch.value += 1; }}>›</button></span>
      </div>
      <Picture label="The stretch over time" kind="near" draw={drawStretch} of={[evidence.value, strip.value, place.value]} />
      <div class="acts">
        <button class="btn small" disabled={!part} onClick={() => showInPlots(part!)}>Show in Plots</button>
        <button class="btn small" disabled={own.values[cell] === own.reference[cell]} onClick={() => { setValues([cell], [own.reference[cell]!], `${own.name}: set to the reference`); endDrag(); }}>Back to {referenceName.value}</button>
      </div>
    </section>
  );
}

function showInPlots(part: Part): void {
  const [begin, end] = part.stretches[shownStretch.value]!;
  const pause = Math.max((end - begin) * 2, 10);
  showDataset(part.number);
  stretch.value = { begin: begin - pause, end: end + pause };
  brush.value = { point: { parameter: name.value, value: cell.value } };
  screen.value = "plots";
}

function drawNear(pen: Pen, width: number, height: number): void {
  const [own, data] = [table.value, evidence.value];
  if (own === null || data === null || own.axes.length < 2) return;
  const around = (axis: 0 | 1) => {
    const points = own.axes[axis]!.points;
    const at = selection.value.active[axis];
    return widened([points[Math.max(0, at - 2)]!, points[Math.min(points.length - 1, at + 2)]!], 0.02);
  };
  const box = { left: 40, right: width - 12, top: 8, bottom: height - 36 };
  const plot = area(pen, box, around(0), around(1), { xTicks: undefined, title: own.axes[0]!.input });
  plot.clip(() => {
    for (const lit of [false, true]) {
      pen.fillStyle = token(lit ? "lit" : "before");
      for (let k = 0; k < data.x.length; k++) {
        if (data.weight[k]! > 0 !== lit) continue;
        pen.beginPath();
        pen.arc(plot.x(data.x[k]!), plot.y(data.y[k]!), lit ? 1 + 1.4 * data.weight[k]! : 1, 0, 7);
        pen.fill();
      }
    }
    const [i, j] = selection.value.active;
    pen.fillStyle = token("drag");
    pen.strokeStyle = token("paper");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(plot.x(own.axes[0]!.points[i]!), plot.y(own.axes[1]!.points[j]!), 5.5, 0, 7);
    pen.fill();
    pen.stroke();
  });
}

function drawStretch(pen: Pen, width: number, height: number): void {
  const data = strip.value;
  const ends = shownPart.value?.stretches[shownStretch.value];
  if (data === null || ends === undefined || data.x.length === 0) return;
  const box = { left: 40, right: width - 12, top: 8, bottom: height - 36 };
  const xs = Float64Array.from(data.x, (x) => x + data.begin);
  const plot = area(pen, box, extent(xs), widened(extent(data.measured, data.now), 0.06), { title: settled.value.datasets[shownPart.value!.number]?.timed ? "time [s]" : "point" });
  plot.clip(() => {
    pen.fillStyle = token("lit");
    pen.globalAlpha = 0.14;
    pen.fillRect(plot.x(ends[0]), box.top, Math.max(1.5, plot.x(ends[1]) - plot.x(ends[0])), box.bottom - box.top);
    pen.globalAlpha = 1;
    const at = xs.map(plot.x);
    line(pen, at, Float64Array.from(data.measured, plot.y), token("measured"), 1.25);
    line(pen, at, Float64Array.from(data.now, plot.y), token("model"), 1.25);
  });
}
