// What is drawn in the plots: one question for each, asked once per change and only while the plots are open.

import { batch, computed, effect } from "@preact/signals";
import { newest } from "./connection";
import {
  type Brush,
  brush,
  criterionNumber,
  cursor,
  dataset,
  datasetNumber,
  follow,
  hover,
  isStretch,
  keyOf,
  only,
  range,
  type Stretch,
  visible,
  width,
} from "./plots";
import type {
  AskedPoints,
  AskedScatter,
  AskedStrip,
  BrushedConditions,
  ScatterArrays,
  SignalName,
  StatisticsRow,
} from "./replies";
import { onRenewal, scoped } from "./scope";
import { request, revision, screen, settled } from "./store";
import { matrixSignals, rows } from "./strip-rows";

export interface Drawn {
  begin: number;
  raw: boolean;
  x: Float32Array;
  lines: Map<string, Float32Array>;
  lit: Float32Array;
  missing: Map<string, string>;
}

export const drawn = scoped<Drawn | null>(null);
export const overview = scoped<Drawn | null>(null);

const open = computed(() => screen.value === "plots" && dataset.value !== undefined);
const lines = computed(
  () => new Map(rows.value.flatMap((row) => row.lines.map((line) => [keyOf(line.signal), line.signal]))),
);
const pixels = computed(() => Math.max(50, Math.round(width.value)));

async function fetchStrip(
  signals: SignalName[],
  part: Stretch,
  given: Pick<AskedStrip, "only" | "brush">,
): Promise<Drawn | null> {
  const reply = await request("strip", {
    dataset: datasetNumber.peek(),
    signals,
    begin: part.begin,
    end: part.end,
    pixels: pixels.peek(),
    ...given,
  });
  if (reply === null) return null;
  const named = signals.map((own, k) => [keyOf(own), reply.arrays[String(k)]] as const);
  const missing = Object.entries(reply.head.missing).map(
    ([k, reason]) => [keyOf(signals[Number(k)]!), reason] as const,
  );
  const present = named.filter((each): each is readonly [string, Float32Array] => each[1] !== undefined);
  return {
    begin: reply.head.begin,
    raw: reply.head.raw,
    x: reply.arrays.x,
    lines: new Map(present),
    lit: reply.arrays.lit,
    missing: new Map(missing),
  };
}

const load = newest(
  async ({
    signals,
    part,
    given,
  }: {
    signals: SignalName[];
    part: Stretch;
    given: Pick<AskedStrip, "only" | "brush">;
  }) => {
    drawn.value = (await fetchStrip(signals, part, given)) ?? drawn.value;
  },
);

effect(() => {
  void [revision.value, datasetNumber.value, pixels.value];
  const lit = isStretch(brush.value) ? null : brush.value; // a stretch is drawn without a question
  if (open.value)
    load({ signals: [...lines.value.values()], part: visible.value, given: { only: only.value, brush: lit } });
});

const loadOverview = newest(async (own: { signals: SignalName[]; part: Stretch }) => {
  overview.value = await fetchStrip(own.signals, own.part, {});
});

effect(() => {
  const own = dataset.value;
  const signals = rows.value[0]?.lines.map((line) => line.signal) ?? [];
  void pixels.value;
  if (open.value && own !== undefined && signals.length)
    loadOverview({ signals, part: { begin: own.begin, end: own.end } });
});

export const pair = scoped<[SignalName, SignalName] | null>(null); // x and y; null is calculated over measured
export const matrixOpen = scoped(false);

const plotted = computed(() => {
  const wanted = [...(pair.value ?? []), ...(matrixOpen.value ? matrixSignals.value : [])];
  return [...new Map(wanted.map((own) => [keyOf(own), own])).values()];
});

/** The sample under the cursor, with the exact values of all lines. */
export interface Sample {
  dataset: number;
  sample: number;
  position: number;
  values: Map<string, number>;
}
export const sample = scoped<Sample | null>(null);

/** What is known at the cursor: the lines of the strips, and the axes of the scatter plots. */
const atCursor = computed(() => {
  const fitted = settled.value.criteria[criterionNumber.value];
  const axes: SignalName[] = fitted
    ? [
        { kind: "target", name: String(criterionNumber.value) },
        { kind: "node", name: fitted.node },
      ]
    : [];
  return new Map([...lines.value, ...[...axes, ...plotted.value].map((own) => [keyOf(own), own] as const)]);
});

let steps = 0;
const loadSample = newest(async (_: null) => {
  const [position, step, signals, number] = [cursor.value, steps, [...atCursor.value.values()], datasetNumber.value];
  steps = 0;
  if (position === null) return;
  const reply = await request("cursor", { dataset: number, position, step, signals });
  if (reply === null || number !== datasetNumber.value) return;
  const values = reply.head.values.map((value, k) => [keyOf(signals[k]!), value ?? NaN] as const);
  const next = { dataset: number, sample: reply.head.sample, position: reply.head.position, values: new Map(values) };
  batch(() => {
    sample.value = next;
    if (cursor.value === position) cursor.value = next.position;
  });
  if (step) follow(next.position);
});

const askedFor = computed(() => `${revision.value} ${datasetNumber.value} ${[...atCursor.value.keys()].join()}`);
let answered = "";
onRenewal(() => {
  steps = 0;
  answered = "";
});

effect(() => {
  const asked = askedFor.value;
  if (cursor.value === null) sample.value = null;
  else if (open.value && !(cursor.value === sample.peek()?.position && answered === asked)) {
    answered = asked;
    loadSample(null);
  }
});

/** Move the cursor by samples, from the middle of the strips if it is nowhere. */
export function stepCursor(by: number): void {
  steps += by;
  hover.value = null; // the values of the cursor are looked at now
  if (cursor.value === null) cursor.value = (visible.value.begin + visible.value.end) / 2;
  else loadSample(null);
}

export const scatter = scoped<ScatterArrays | null>(null);
export const both = scoped(false);

const loadScatter = newest(async (given: AskedScatter) => {
  const reply = await request("scatter", given);
  scatter.value = reply === null ? null : reply.arrays;
});

const selected = computed(() => ({
  dataset: datasetNumber.value,
  criterion: criterionNumber.value,
  only: only.value,
  brush: brush.value,
}));

effect(() => {
  void revision.value;
  if (open.value) loadScatter({ ...selected.value, both: both.value });
});

/** Signals at the same samples, to be drawn over each other. */
export interface Points {
  signals: SignalName[];
  begin: number;
  position: Float32Array;
  lit: Float32Array;
  values: (Float32Array | undefined)[];
}
export const points = scoped<Points | null>(null);
const loadPoints = newest(async (given: AskedPoints) => {
  const { signals } = given;
  const reply = await request("points", given);
  if (reply === null) return;
  points.value = {
    signals,
    begin: reply.head.begin,
    position: reply.arrays.position,
    lit: reply.arrays.lit,
    values: signals.map((_, k) => reply.arrays[String(k)]),
  };
});

effect(() => {
  void revision.value;
  if (open.value && plotted.value.length)
    loadPoints({ ...selected.value, signals: plotted.value, most: matrixOpen.value ? 2500 : 6000 });
});

/** What is brushed: the weight of each grid point in it, its errors, statistics of the lines, and its conditions. */
export interface Brushed {
  samples: number;
  weights: Record<string, Float32Array>;
  rmse: number;
  mean: number;
  statistics: Map<string, StatisticsRow>;
  conditions: BrushedConditions;
}
export const brushed = scoped<Brushed | null>(null);

const loadBrushed = newest(async (own: Brush) => {
  const given = { dataset: datasetNumber.value, brush: own };
  const error: SignalName = { kind: "error", name: String(criterionNumber.value) };
  const signals = [...lines.value.values()];
  const [passed, numbers, conditions] = await Promise.all([
    request("passed", given),
    request("statistics", { ...given, signals: [error, ...signals] }),
    request("conditions", given),
  ]);
  if (passed === null || numbers === null || conditions === null || brush.value === null) return;
  const [row, ...others] = numbers.head.statistics;
  brushed.value = {
    samples: passed.head.samples,
    weights: passed.arrays,
    rmse: row?.rms ?? NaN,
    mean: row?.mean ?? NaN,
    statistics: new Map(signals.map((each, k) => [keyOf(each), others[k]!])),
    conditions: conditions.head,
  };
});

effect(() => {
  void [revision.value, datasetNumber.value, criterionNumber.value, lines.value];
  if (brush.value === null) brushed.value = null;
  else if (open.value) loadBrushed(brush.value);
});

/** The measured range: each line at both ends, and its statistics between them. */
export interface RangeRow {
  signal: SignalName;
  label: string;
  colour: string;
  begin: number;
  end: number;
  statistics: StatisticsRow;
}
export const rangeRows = scoped<RangeRow[] | null>(null);

const loadRange = newest(async (own: Stretch) => {
  const [number, signals] = [datasetNumber.value, [...lines.value.values()]];
  const at = (position: number) => request("cursor", { dataset: number, position, signals });
  const [begin, end, numbers] = await Promise.all([
    at(own.begin),
    at(own.end),
    request("statistics", { dataset: number, begin: own.begin, end: own.end, signals }),
  ]);
  if (!begin || !end || !numbers || range.value === null) return;
  const shown = rows.value.flatMap((row) =>
    row.lines.map((line) => ({
      key: keyOf(line.signal),
      label: row.lines.length > 1 ? line.label : row.title,
      colour: line.colour,
    })),
  );
  const drawnAs = new Map(shown.map((line) => [line.key, line]));
  rangeRows.value = signals.map((each, k) => ({
    signal: each,
    label: "",
    colour: "measured",
    ...drawnAs.get(keyOf(each)),
    begin: begin.head.values[k] ?? NaN,
    end: end.head.values[k] ?? NaN,
    statistics: numbers.head.statistics[k]!,
  }));
});

effect(() => {
  void [revision.value, datasetNumber.value, lines.value];
  if (range.value === null) rangeRows.value = null;
  else if (open.value) loadRange(range.value);
});
