// What the plots show: dataset, stretch, strips, brush and cursor. Every plot of the screen reads these.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "./connection";
import { request, revision, screen, settled } from "./store";

export interface SignalName { kind: "channel" | "target" | "node" | "start" | "error" | "start error"; name: string }
export interface Line { signal: SignalName; label: string; colour: string }
export interface Row { title: string; unit: string; weight: number; lines: Line[] }
export interface Stretch { begin: number; end: number }

export const datasetNumber = signal(0);
export const stretch = signal<Stretch | null>(null); // null is the whole dataset
export const brush = signal<Stretch | null>(null);
export const range = signal<Stretch | null>(null);
export const cursor = signal<number | null>(null);
export const extra = signal<SignalName[]>([]); // strips that the user has added
export const width = signal(800);

export const dataset = computed(() => settled.value.datasets[Math.min(datasetNumber.value, settled.value.datasets.length - 1)]);

export const visible = computed<Stretch>(() => {
  const own = dataset.value;
  return stretch.value ?? { begin: own?.begin ?? 0, end: own?.end ?? 1 };
});

/** The strips: each criterion with its error, the inputs of the function, and what the user has added. */
export const rows = computed<Row[]>(() => {
  const own = dataset.value;
  if (own === undefined) return [];
  const unitOf = (name: string) => own.channels.find((c) => c.name === name)?.unit ?? settled.value.nodes.find((n) => n.name === name)?.unit ?? "";
  const criteria = settled.value.criteria.flatMap<Row>((criterion, i) => [
    {
      title: criterion.node, unit: criterion.unit, weight: 1.6,
      lines: [
        { signal: { kind: "target", name: String(i) }, label: "measured", colour: "measured" },
        { signal: { kind: "start", name: criterion.node }, label: "start", colour: "before" },
        { signal: { kind: "node", name: criterion.node }, label: "now", colour: "model" },
      ],
    },
    { title: "Error", unit: criterion.unit, weight: 1, lines: [{ signal: { kind: "error", name: String(i) }, label: "now", colour: "error" }] },
  ]);
  const channels = settled.value.inputs.filter((name) => own.channels.some((c) => c.name === name));
  const others = [...channels.map<SignalName>((name) => ({ kind: "channel", name })), ...extra.value];
  return [...criteria, ...others.map<Row>((each) => ({
    title: each.name, unit: unitOf(each.name), weight: 1,
    lines: [{ signal: each, label: each.kind === "channel" ? "measured" : "now", colour: each.kind === "channel" ? "measured" : "model" }],
  }))];
});

export interface Drawn { begin: number; raw: boolean; x: Float32Array; lines: Float32Array[] }
export const drawn = signal<Drawn | null>(null);
export const overview = signal<Drawn | null>(null);

async function fetchStrip(signals: SignalName[], part: Stretch, pixels: number): Promise<Drawn | null> {
  const reply = await request("strip", { dataset: datasetNumber.value, signals, begin: part.begin, end: part.end, pixels });
  if (reply === null) return null;
  return { begin: reply.head.begin as number, raw: reply.head.raw as boolean, x: reply.arrays.x!, lines: signals.map((_, k) => reply.arrays[String(k)]!) };
}

const load = newest(async (what: { signals: SignalName[]; part: Stretch; pixels: number }) => {
  drawn.value = await fetchStrip(what.signals, what.part, what.pixels) ?? drawn.value;
});

const loadOverview = newest(async (what: { signals: SignalName[]; part: Stretch; pixels: number }) => {
  overview.value = await fetchStrip(what.signals, what.part, what.pixels);
});

effect(() => {
  void revision.value;
  if (screen.value !== "plots" || dataset.value === undefined) return;
  load({ signals: rows.value.flatMap((row) => row.lines.map((line) => line.signal)), part: visible.value, pixels: Math.max(50, Math.round(width.value)) });
});

effect(() => {
  const own = dataset.value;
  if (screen.value !== "plots" || own === undefined) return;
  const first = rows.value[0]?.lines[0]?.signal;
  if (first) loadOverview({ signals: [first], part: { begin: own.begin, end: own.end }, pixels: Math.max(50, Math.round(width.value)) });
});

export interface Scatter { measured: Float32Array; now: Float32Array; start: Float32Array; edges: Float32Array; after: Float32Array; before: Float32Array }
export const scatter = signal<Scatter | null>(null);
export const both = signal(false);

const loadScatter = newest(async (given: Record<string, unknown>) => {
  const reply = await request("scatter", given);
  scatter.value = reply === null ? null : (reply.arrays as unknown as Scatter);
});

effect(() => {
  void revision.value;
  if (screen.value === "plots" && dataset.value !== undefined) loadScatter({ dataset: datasetNumber.value, criterion: 0, both: both.value });
});

export interface Brushed { samples: number; weights: Record<string, Float32Array>; rmse: number; mean: number }
export const brushed = signal<Brushed | null>(null);

const loadBrushed = newest(async (part: Stretch) => {
  const given = { dataset: datasetNumber.value, begin: part.begin, end: part.end };
  const [passed, numbers] = await Promise.all([request("passed", given), request("statistics", { ...given, signals: [{ kind: "error", name: "0" }] })]);
  if (passed === null || numbers === null) return;
  const [row] = numbers.head.statistics as { rms: number | null; mean: number | null }[];
  brushed.value = { samples: passed.head.samples as number, weights: passed.arrays, rmse: row?.rms ?? NaN, mean: row?.mean ?? NaN };
});

effect(() => {
  void revision.value;
  if (brush.value === null) brushed.value = null;
  else loadBrushed(brush.value);
});

const earlier: (Stretch | null)[] = [];

export function zoom(to: Stretch | null): void {
  const own = dataset.value;
  if (own === undefined) return;
  earlier.push(stretch.value);
  if (to === null) stretch.value = null;
  else {
    const begin = Math.max(own.begin, to.begin);
    const end = Math.min(own.end, to.end);
    if (end > begin) stretch.value = { begin, end };
  }
}

export function back(): void {
  if (earlier.length) stretch.value = earlier.pop()!;
}

/** Zoom about a position; a factor below 1 shows less. */
export function zoomAt(position: number, factor: number): void {
  const { begin, end } = visible.value;
  const own = dataset.value!;
  const wide = Math.min(own.end - own.begin, (end - begin) * factor);
  const share = (position - begin) / (end - begin);
  const from = Math.max(own.begin, Math.min(own.end - wide, position - share * wide));
  stretch.value = { begin: from, end: from + wide };
}
