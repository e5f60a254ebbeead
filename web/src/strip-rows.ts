// The strips: which signals each shows, in which order and height. The choice is kept in this browser, by project.

import { computed, effect } from "@preact/signals";
import { withUnit } from "./drawing/numbers";
import { criterionNumber, dataset, datasetNumber, keyOf } from "./plots";
import type { SignalName, SignalRow } from "./replies";
import { scoped } from "./scope";
import { request, screen, settled, state } from "./store";

export interface Line {
  signal: SignalName;
  label: string;
  colour: string;
}
export interface Row {
  title: string;
  unit: string;
  weight: number;
  lines: Line[];
}
interface Spec {
  weight: number;
  lines: SignalName[];
}

const COLOURS: Record<SignalName["kind"], string> = {
  channel: "measured",
  target: "measured",
  node: "model",
  start: "before",
  error: "error",
  "start error": "before",
};
const FURTHER = ["line-1", "line-2", "line-3", "line-4"]; // of further lines in a strip

const chosen = scoped<Spec[] | null>(null); // null: those of the project as it is
const matrix = scoped<SignalName[] | null>(null);
export const SIGNAL = "application/x-kennfeld-signal"; // what is dragged from the list of signals
export const active = scoped(0); // the strip that Shift+Enter adds to
export const listed = scoped<SignalRow[]>([]);
export const searching = scoped(false); // the list of signals is open

const project = computed(() => state.value.project?.path ?? "");

function read(key: string): { strips: Spec[] | null; matrix: SignalName[] | null } {
  try {
    const stored = JSON.parse(localStorage.getItem(key) ?? "{}");
    const strips = Array.isArray(stored.strips)
      ? (stored.strips as Spec[]).filter((each) => Array.isArray(each?.lines) && each.lines.every(isSignal))
      : null;
    const signals = Array.isArray(stored.matrix) ? (stored.matrix as SignalName[]).filter(isSignal) : null;
    return {
      strips: strips?.map((each) => ({ weight: Number(each.weight) || 1, lines: each.lines })) ?? null,
      matrix: signals,
    };
  } catch {
    return { strips: null, matrix: null };
  }
}

const isSignal = (each: SignalName): boolean => typeof each?.name === "string" && each.kind in COLOURS;

function keep(): void {
  try {
    localStorage.setItem(
      `kennfeld.plots:${project.value}`,
      JSON.stringify({ strips: chosen.value, matrix: matrix.value }),
    );
  } catch {
    /* a browser without storage forgets the choice */
  }
}

/** The inputs of the function that are channels of the dataset. */
export const inputs = computed<SignalName[]>(() => {
  const names = new Set(dataset.value?.channels.map((each) => each.name));
  return settled.value.inputs.filter((name) => names.has(name)).map((name) => ({ kind: "channel", name }));
});

/** False if the target of a criterion is a channel that the dataset lacks. */
function isScored(target: string): boolean {
  const own = dataset.value?.channels.some((each) => each.name === target) ?? true;
  const elsewhere = settled.value.datasets.some((data) => data.channels.some((each) => each.name === target));
  return own || !elsewhere;
}

const defaults = computed<Spec[]>(() => [
  ...settled.value.criteria.flatMap<Spec>((criterion, i) =>
    !isScored(criterion.target)
      ? []
      : [
          {
            weight: 1.6,
            lines: [
              { kind: "target", name: String(i) },
              { kind: "node", name: criterion.node },
              { kind: "start", name: criterion.node },
            ],
          },
          { weight: 1, lines: [{ kind: "error", name: String(i) }] },
        ],
  ),
  ...inputs.value.map<Spec>((each) => ({ weight: 1, lines: [each] })),
]);

const specs = computed(() => chosen.value ?? defaults.value);

export const rows = computed<Row[]>(() => (dataset.value === undefined ? [] : specs.value.map(describe)));

/** Which strip is at a share of the height. */
export function rowAt(share: number): number {
  const total = rows.value.reduce((sum, row) => sum + row.weight, 0);
  let below = 0;
  for (const [r, row] of rows.value.entries()) {
    below += row.weight / total;
    if (share < below) return r;
  }
  return rows.value.length - 1;
}

/** The signals of the scatter matrix: the inputs of the function and the error. */
export const matrixSignals = computed<SignalName[]>(
  () => matrix.value ?? [...inputs.value.slice(0, 5), { kind: "error", name: String(criterionNumber.value) }],
);

function describe({ weight, lines }: Spec): Row {
  const first = lines[0];
  const used = new Set<string>();
  const described = lines.map<Line>((each) => {
    const own = COLOURS[each.kind];
    const colour = used.has(own) ? (FURTHER.find((next) => !used.has(next)) ?? own) : own;
    used.add(colour);
    const same = first !== undefined && quantityOf(each) === quantityOf(first);
    return { signal: each, colour, label: same ? roleOf(each) : nameOf(each) };
  });
  return { title: first ? quantityOf(first) : "", unit: first ? unitOf(first) : "", weight, lines: described };
}

const nodeOf = (number: string): string =>
  settled.value.criteria[Number(number)]?.node ?? `criterion ${Number(number) + 1}`;

function quantityOf(own: SignalName): string {
  if (own.kind === "error" || own.kind === "start error")
    return settled.value.criteria.length > 1 ? `Error of ${nodeOf(own.name)}` : "Error";
  return own.kind === "target" ? nodeOf(own.name) : own.name;
}

const roleOf = (own: SignalName): string =>
  ({ channel: "measured", target: "measured", node: "now", start: "start", error: "now", "start error": "start" })[
    own.kind
  ];

/** A signal in words. */
export function nameOf(own: SignalName): string {
  const name = quantityOf(own);
  return own.kind === "target"
    ? `${name}, measured`
    : own.kind === "start" || own.kind === "start error"
      ? `${name} at the start`
      : name;
}

export function unitOf(own: SignalName): string {
  if (own.kind === "channel")
    return dataset.value?.channels.find((each) => each.name === own.name)?.unit ?? own.unit ?? "";
  if (own.kind === "node" || own.kind === "start")
    return settled.value.nodes.find((each) => each.name === own.name)?.unit ?? "";
  return settled.value.criteria[Number(own.name)]?.unit ?? "";
}

/** A signal with its unit. */
export const titleOf = (own: SignalName): string => withUnit(nameOf(own), unitOf(own));

function change(next: Spec[] | null): void {
  chosen.value = next;
  active.value = Math.max(0, Math.min(active.value, (next?.length ?? 1) - 1));
  keep();
}

const plainSignal = ({ kind, name, unit }: SignalName): SignalName =>
  kind === "channel" && unit ? { kind, name, unit } : { kind, name };

/** Show a signal in a strip of its own, below the active one. */
export function addStrip(own: SignalName): void {
  const at = Math.min(active.value + 1, specs.value.length);
  change(specs.value.toSpliced(at, 0, { weight: 1, lines: [plainSignal(own)] }));
  active.value = at;
}

/** Show a signal in an existing strip. */
export function addLine(row: number, own: SignalName): void {
  const spec = specs.value[row];
  if (spec === undefined) addStrip(own);
  else if (!spec.lines.some((each) => keyOf(each) === keyOf(own)))
    change(specs.value.with(row, { ...spec, lines: [...spec.lines, plainSignal(own)] }));
}

export function removeStrip(row: number): void {
  change(specs.value.toSpliced(row, 1));
}

/** Take a line out of a strip; a strip without lines goes. */
export function removeLine(row: number, own: SignalName): void {
  const spec = specs.value[row]!;
  const lines = spec.lines.filter((each) => keyOf(each) !== keyOf(own));
  if (lines.length) change(specs.value.with(row, { ...spec, lines }));
  else removeStrip(row);
}

export function moveStrip(from: number, to: number): void {
  if (to < 0 || to >= specs.value.length || from === to) return;
  change(specs.value.toSpliced(from, 1).toSpliced(to, 0, specs.value[from]!));
  active.value = to;
}

/** Make a strip higher or lower by a share of the mean height; the one below gives or takes it. */
export function resizeStrip(row: number, by: number): void {
  const [own, below] = [specs.value[row], specs.value[row + 1]];
  if (own === undefined) return;
  const most = below === undefined ? 4 - own.weight : below.weight - 0.4;
  const step = Math.max(0.4 - own.weight, Math.min(most, by));
  const next = specs.value.with(row, { ...own, weight: own.weight + step });
  change(below === undefined ? next : next.with(row + 1, { ...below, weight: below.weight - step }));
}

export function resetStrips(): void {
  change(null);
}

export function setMatrix(signals: SignalName[] | null): void {
  matrix.value = signals?.map(plainSignal) ?? null;
  keep();
}

const textRevision = computed(() => state.value.textRevision);

effect(() => {
  void textRevision.value;
  if (screen.value === "plots" && dataset.value !== undefined && searching.value) void load(datasetNumber.value);
});

async function load(number: number): Promise<void> {
  const reply = await request("signals", { dataset: number });
  if (reply !== null) listed.value = reply.head.signals;
}

effect(() => {
  const stored = read(`kennfeld.plots:${project.value}`);
  chosen.value = stored.strips;
  matrix.value = stored.matrix;
});
