// What a grid point rests on: its samples, their errors, where they look the table up, and when.

import { batch, computed, effect } from "@preact/signals";
import { newest } from "../connection";
import { area, extent, line, type Pen, widened } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { ring } from "../drawing/marks";
import { count, plain, signed, significant, unitText, withUnit } from "../drawing/numbers";
import { lastUpTo } from "../drawing/strips";
import { nearestPixel, type Read } from "../hover-tip";
import { brush, criterion, criterionNumber, showDataset, stretch } from "../plots";
import type { EditedTable, InformingRow } from "../replies";
import { scoped } from "../scope";
import {
  endDrag,
  message,
  referenceName,
  request,
  revision,
  screen,
  selection,
  settled,
  setValues,
  table,
} from "../store";
import { fitOnly, whyUnfit } from "./cell-marks";
import { CriterionChoice } from "./criterion-choice";
import { Picture } from "./picture";
import { cellAt } from "./table-cells";

interface Evidence {
  name: string;
  cell: number;
  parts: InformingRow[];
  most: number;
  x: Float32Array;
  y: Float32Array;
  weight: Float32Array;
}
interface Strip {
  begin: number;
  x: Float32Array;
  measured: Float32Array;
  now: Float32Array;
}

const evidence = scoped<Evidence | null>(null);
const shownStretch = scoped(0);
const strip = scoped<Strip | null>(null);

const load = newest(async (given: { name: string; cell: number; criterion: number }) => {
  const reply = await request("informing", given);
  if (reply === null) return;
  const none = new Float32Array();
  const samples = { x: none, y: none, weight: none, ...reply.arrays };
  const before = evidence.value;
  const same = before !== null && (["x", "y", "weight"] as const).every((key) => equal(before[key], samples[key]));
  const { x, y, weight } = same ? before : samples; // the same arrays are not drawn again
  const next = {
    name: given.name,
    cell: given.cell,
    parts: reply.head.datasets,
    most: reply.head.most ?? 0,
    x,
    y,
    weight,
  };
  batch(() => {
    if (next.name !== evidence.value?.name || next.cell !== evidence.value.cell) shownStretch.value = 0;
    evidence.value = next;
  });
});

const equal = (a: Float32Array, b: Float32Array): boolean =>
  a.length === b.length && a.every((value, k) => value === b[k]);

const loadStrip = newest(async ([dataset, from, to]: [number, number, number]) => {
  const number = String(criterionNumber.value);
  const pause = Math.max((to - from) * 1.5, 4);
  const [begin, end] = [from - pause, to + pause];
  const node = criterion.value?.node ?? "";
  const reply = await request("strip", {
    dataset,
    begin,
    end,
    pixels: 240,
    signals: [
      { kind: "target", name: number },
      { kind: "node", name: node },
    ],
  });
  if (reply !== null)
    strip.value = { begin: reply.head.begin, x: reply.arrays.x, measured: reply.arrays["0"]!, now: reply.arrays["1"]! };
});

const name = computed(() => table.value?.name ?? "");
const cell = computed(() => {
  const own = table.value;
  return own === null || own.axes.length === 0 ? -1 : cellAt(own, ...selection.value.active);
});

effect(() => {
  void revision.value;
  if (screen.value === "parameters" && cell.value >= 0)
    load({ name: name.value, cell: cell.value, criterion: criterionNumber.value });
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

export function EvidencePane({ own }: { own: EditedTable }) {
  return (
    <section class="pane evid" aria-label="Evidence">
      <Facts own={own} />
      <div class="sub2 s1">
        <b>In the {own.kind}</b>
        <span class="key">
          <i class="dot" style={{ background: "var(--lit)" }} />
          its samples
        </span>
        <span class="key">
          <i class="dot" style={{ background: "var(--before)" }} />
          others
        </span>
      </div>
      <Near name={own.name} />
      <StretchHead />
      <StretchPicture />
      <Actions own={own} />
    </section>
  );
}

/** How the value is known. */
function origin(own: EditedTable, cell: number): string {
  if (own.locked.includes(cell)) return "locked";
  if (own.pinned.includes(cell)) return "pinned";
  if (own.values[cell] !== own.reference[cell]) return "by hand";
  return own.samples?.[cell] === 0 ? "no data" : "data";
}

function Facts({ own }: { own: EditedTable }) {
  const cell = cellAt(own, ...selection.value.active);
  const part = shownPart.value;
  const parts = evidence.value?.parts ?? [];
  const sum = (use: string, value: (part: InformingRow) => number) =>
    parts.filter((each) => each.use === use).reduce((total, each) => total + value(each), 0);
  const deviation = own.deviation?.[cell];
  const how = origin(own, cell);
  const worse = part !== undefined && Math.abs(part.meanNow ?? 0) > Math.abs(part.meanBefore ?? 0);
  return (
    <>
      <div class="head">
        <h2 title="What this point rests on">
          <span class="wide">What this point rests on</span>
          <span class="narrow">Rests on</span>
        </h2>
        <span class="right">
          <CriterionChoice />
          <span class={`tag ${how === "data" ? "g" : "w"}`}>{how}</span>
        </span>
      </div>
      <div class="facts3">
        <dl class="facts">
          <dt>grid point</dt>
          <dd>
            {own.axes.map((axis, k) => (
              <>
                {k > 0 && ", "}
                {plain(axis.points[selection.value.active[k]!] ?? 0, 4)} <u>{axis.unit}</u>
              </>
            ))}
          </dd>
          <dt>now</dt>
          <dd>
            <b>{significant(own.values[cell]!)}</b> <u>{own.unit}</u>
          </dd>
          <dt>{referenceName.value}, difference</dt>
          <dd>
            {significant(own.reference[cell]!)}, {signed(own.values[cell]! - own.reference[cell]!, 4)}
          </dd>
          <dt>std deviation</dt>
          <dd>
            {deviation === undefined
              ? "after a run"
              : deviation === null
                ? "undetermined"
                : `± ${significant(deviation, 3)}`}
          </dd>
          <dt>training samples</dt>
          <dd data-samples="training">
            {count(sum("training", (each) => each.samples))} <u>in</u> {count(sum("training", (each) => each.count))}{" "}
            <u>stretches</u>
          </dd>
          {sum("test", (each) => each.samples) > 0 && (
            <>
              <dt title="They look the point up, but it does not rest on them">test samples</dt>
              <dd data-samples="test">
                {count(sum("test", (each) => each.samples))} <u>in</u> {count(sum("test", (each) => each.count))}{" "}
                <u>stretches</u>
              </dd>
            </>
          )}
          <dt class="cut">mean error in {part?.dataset ?? "the data"}</dt>
          <dd>
            {part ? (
              <>
                {signed(part.meanBefore ?? NaN)} → <b class={worse ? "bad" : ""}>{signed(part.meanNow ?? NaN)}</b>
              </>
            ) : (
              "–"
            )}
          </dd>
        </dl>
        <Timeline part={part} />
      </div>
    </>
  );
}

/** Where in the dataset its samples are. */
function Timeline({ part }: { part: InformingRow | undefined }) {
  const dataset = part && settled.value.datasets[part.number];
  if (part === undefined || dataset === undefined) return null;
  const draw = (pen: Pen, width: number, height: number) => {
    const x = (time: number) => ((time - dataset.begin) / (dataset.end - dataset.begin)) * width;
    pen.fillStyle = token("raise");
    pen.fillRect(0, 0, width, height);
    pen.fillStyle = token("lit");
    for (const [begin, end] of part.stretches) pen.fillRect(x(begin), 0, Math.max(1.2, x(end) - x(begin)), height);
  };
  return (
    <div class="timeline">
      <Picture label={`Where ${part.dataset} has its samples`} kind="places" draw={draw} of={[part]} />
      <div class="ends q">
        <span>
          {plain(dataset.begin, 4)}
          {dataset.timed ? " s" : ""}
        </span>
        <span>{part.dataset}</span>
        <span>{plain(dataset.end, 4)}</span>
      </div>
    </div>
  );
}

function Near({ name }: { name: string }) {
  return (
    <Picture
      label="Samples around the grid point"
      kind="near n1"
      draw={drawNear}
      of={[evidence.value?.x, selection.value, name]}
    />
  );
}

function StretchHead() {
  const part = shownPart.value;
  const go = (by: number) => {
    shownStretch.value += by;
  };
  return (
    <div class="sub2 s2">
      <b class="cut">In {part?.dataset ?? "the data"}</b>
      <span class="q">{part ? `${shownStretch.value + 1} of ${part.stretches.length}, longest first` : ""}</span>
      <span class="right">
        <button
          class="btn bare small"
          aria-label="Previous stretch"
          disabled={shownStretch.value === 0}
          onClick={() => go(-1)}
        >
          ‹
        </button>
        <button
          class="btn bare small"
          aria-label="Next stretch"
          disabled={!part || shownStretch.value + 1 >= part.stretches.length}
          onClick={() => go(1)}
        >
          ›
        </button>
      </span>
    </div>
  );
}

function StretchPicture() {
  return <Picture label="The stretch over time" kind="near n2" draw={drawStretch} of={[strip.value, place.value]} />;
}

function Actions({ own }: { own: EditedTable }) {
  const cell = cellAt(own, ...selection.value.active);
  const part = shownPart.value;
  const unfit = own.locked.includes(cell) ? "locked" : whyUnfit(own);
  const reset = () => {
    setValues([cell], [own.reference[cell]!], `${own.name}: set to the reference`);
    endDrag();
  };
  return (
    <div class="acts">
      <button class="btn small" disabled={!part} onClick={() => showInPlots(part!)}>
        Show in Plots
      </button>
      <button
        class="btn small"
        disabled={unfit !== ""}
        title={unfit ? `It cannot be fitted: ${unfit}` : "A run in which all other values are held"}
        onClick={() => fitOnly(own, true)}
      >
        Fit this point only
      </button>
      <button class="btn small" disabled={own.values[cell] === own.reference[cell]} onClick={reset}>
        Back to {referenceName.value}
      </button>
    </div>
  );
}

/** Light up the samples of the point in all plots. */
export function showEvidence(): void {
  if (shownPart.value !== undefined) showInPlots(shownPart.value);
  else message.value = "No sample looks this point up.";
}

function showInPlots(part: InformingRow): void {
  const [begin, end] = part.stretches[shownStretch.value]!;
  const pause = Math.max((end - begin) * 2, 10);
  showDataset(part.number);
  stretch.value = { begin: begin - pause, end: end + pause };
  brush.value = { point: { parameter: name.value, value: cell.value } };
  screen.value = "plots";
}

/** The samples around the point: where they look a map up; of a curve, with what weight they do. */
function drawNear(pen: Pen, width: number, height: number): Read | undefined {
  const [own, data] = [table.value, evidence.value];
  if (own === null || data === null || own.axes.length === 0 || data.name !== own.name) return undefined;
  const curve = own.axes.length === 1;
  const around = (axis: 0 | 1) => {
    const points = own.axes[axis]!.points;
    const at = selection.value.active[axis];
    return widened([points[Math.max(0, at - 2)]!, points[Math.min(points.length - 1, at + 2)]!], 0.02);
  };
  const box = { left: 40, right: width - 12, top: 8, bottom: height - 36 };
  const plot = area(pen, box, around(0), curve ? [0, 1.1] : around(1), {
    title: withUnit(own.axes[0]!.input, own.axes[0]!.unit) + (curve ? ", weight" : ""),
  });
  const [xs, ys] = [data.x, curve ? data.weight : data.y].map((values, k) =>
    Float64Array.from(values, k ? plot.y : plot.x),
  ) as [Float64Array, Float64Array];
  plot.clip(() => {
    pen.fillStyle = token("before");
    for (let k = 0; k < xs.length; k++) if (!(data.weight[k]! > 0)) pen.fillRect(xs[k]! - 0.9, ys[k]! - 0.9, 1.8, 1.8);
    pen.fillStyle = token("lit");
    for (let k = 0; k < xs.length; k++) {
      const side = 2 + 2.4 * data.weight[k]!;
      if (data.weight[k]! > 0) pen.fillRect(xs[k]! - side / 2, ys[k]! - side / 2, side, side);
    }
    const [i, j] = selection.value.active;
    ring(
      pen,
      [plot.x(own.axes[0]!.points[i]!), plot.y(curve ? 1 : own.axes[1]!.points[j]!)],
      5.5,
      token("drag"),
      token("paper"),
      2,
    );
  });
  return (x, y) => {
    const k = nearestPixel(xs, ys, [x, y], 8);
    if (k < 0) return null;
    const [along, across] = own.axes;
    return [
      `weight ${significant(data.weight[k]!, 3)}`,
      `${along!.input} ${significant(data.x[k]!)} ${unitText(along!.unit)}`,
      ...(across ? [`${across.input} ${significant(data.y[k]!)} ${unitText(across.unit)}`] : []),
    ];
  };
}

function drawStretch(pen: Pen, width: number, height: number): Read | undefined {
  const data = strip.value;
  const ends = shownPart.value?.stretches[shownStretch.value];
  if (data === null || ends === undefined || data.x.length === 0) return undefined;
  const box = { left: 40, right: width - 12, top: 8, bottom: height - 36 };
  const xs = Float64Array.from(data.x, (x) => x + data.begin);
  const plot = area(pen, box, extent(xs), widened(extent(data.measured, data.now), 0.06), {
    title: settled.value.datasets[shownPart.value!.number]?.timed ? "time [s]" : "point",
  });
  plot.clip(() => {
    pen.fillStyle = token("lit");
    pen.globalAlpha = 0.14;
    pen.fillRect(plot.x(ends[0]), box.top, Math.max(1.5, plot.x(ends[1]) - plot.x(ends[0])), box.bottom - box.top);
    pen.globalAlpha = 1;
    const at = xs.map(plot.x);
    line(pen, at, Float64Array.from(data.measured, plot.y), token("measured"), 1.25);
    line(pen, at, Float64Array.from(data.now, plot.y), token("model"), 1.25);
  });
  return (x) => {
    const k = lastUpTo(xs, plot.xAt(x));
    return [
      `now ${significant(data.now[k]!)}`,
      `measured ${significant(data.measured[k]!)}`,
      settled.value.datasets[shownPart.value!.number]?.timed ? `at ${plain(xs[k]!, 7)} s` : `point ${plain(xs[k]!, 7)}`,
    ];
  };
}
