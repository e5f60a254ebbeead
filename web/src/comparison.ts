// Two sets of values side by side, and which values of the second one are taken into the present ones.

import { computed, effect } from "@preact/signals";
import { source } from "./calibrations";
import { newest } from "./connection";
import type { AskedChoice, ChoiceScores, ComparedScore, ComparedTable, LimitRow, SetRow, TrustReply } from "./replies";
import { scoped } from "./scope";
import { message, request, screen, settled, state } from "./store";

const NOTHING: Required<TrustReply> = {
  directions: [],
  coupled: [],
  sentence: "",
  advice: "",
  remark: "",
  dimension: 0,
  remedies: [],
  holdings: [],
  noise: [],
  freedom: null,
  values: 0,
};

const picked = scoped({ first: "", second: "" }); // empty: what is of most interest
export const files = scoped<string[]>([]); // calibration files that are compared with
export const history = scoped<SetRow[]>([]);
export const changes = scoped<ComparedTable[]>([]);
export const scores = scoped<ComparedScore[]>([]);
/** The remedy whose effect is shown, by its title. */
export const tried = scoped("");
export const trust = scoped<Required<TrustReply>>(NOTHING);
export const chosen = scoped("");
export const limits = scoped<LimitRow[]>([]);

/** The sets A and B: "now", "start", the number of a run, or "file:NAME". */
export const first = computed(() => picked.value.first || "start");
export const second = computed(() => picked.value.second || String(settled.value.runs.at(-1)?.number ?? "now"));

export function choose(side: "first" | "second", key: string): void {
  picked.value = { first: first.value, second: second.value, [side]: key };
}

/** A set in words: `run 2`. */
export const nameOfSet = (key: string): string => (/^\d+$/.test(key) ? `run ${key}` : key.replace(/^file:/, ""));

export const shown = computed(() => changes.value.find((each) => each.name === chosen.value) ?? ranked.value[0]);

const load = newest(async (_: string) => {
  const both = { first: source(first.value), second: source(second.value) };
  const [compared, known, sets, bounds] = await Promise.all([
    request("compare", both),
    request("trust"),
    request("sets"),
    request("limits", both),
  ]);
  if (compared !== null) {
    changes.value = compared.head.changes;
    scores.value = compared.head.scores;
  }
  if (known !== null) trust.value = { ...NOTHING, ...known.head };
  if (bounds !== null) limits.value = bounds.head.rows;
  if (sets !== null) history.value = sets.head.rows;
});

effect(() => {
  const { revision, project, runs, parameters } = settled.value;
  if (screen.value !== "results" || project === null || parameters.length === 0) return;
  load(`${revision} ${runs.length} ${first.value} ${second.value}`);
});

export type Ranking = "absolute" | "relative" | "mean";
export const ranking = scoped<Ranking>("relative");

const SIZES: Record<Ranking, (own: ComparedTable) => number> = {
  absolute: (own) => own.largest,
  relative: (own) => own.relative,
  mean: (own) => own.mean,
};

/** Tables with the biggest change first. */
export const ranked = computed(() =>
  changes.value.toSorted((a, b) => SIZES[ranking.value](b) - SIZES[ranking.value](a)),
);

export type Taking = "whole" | "by parameter" | "by grid point";
export const taking = scoped<Taking>("whole");
/** Values that are ticked, by parameter. */
export const ticked = scoped<Record<string, ReadonlySet<number>>>({});

const every = (own: ComparedTable): Set<number> => new Set(own.first.map((_, k) => k));

export const isWhole = (own: ComparedTable): boolean => takenOf(own).size === own.first.length;

/** The values of a table that are to be taken. */
export function takenOf(own: ComparedTable): ReadonlySet<number> {
  return taking.value === "whole" ? every(own) : (ticked.value[own.name] ?? new Set());
}

export function tick(own: ComparedTable, cells: Iterable<number>, on: boolean): void {
  const next = new Set(takenOf(own));
  for (const cell of cells) {
    if (on) next.add(cell);
    else next.delete(cell);
  }
  ticked.value = { ...ticked.value, [own.name]: next };
}

export const tickAll = (own: ComparedTable, on: boolean): void => tick(own, every(own), on);

/** Tick all values of these tables, and no others. */
export function tickTables(names: readonly string[]): void {
  ticked.value = Object.fromEntries(
    changes.value.filter((each) => names.includes(each.name)).map((each) => [each.name, every(each)]),
  );
  taking.value = "by parameter";
}

/** What is to be taken, as the server is asked; null if nothing is ticked. */
export const choice = computed<AskedChoice | null>(() => {
  const cells: Record<string, number[] | null> = {};
  for (const own of changes.value) {
    const taken = takenOf(own);
    if (taken.size === own.first.length) cells[own.name] = null;
    else if (taken.size > 0) cells[own.name] = [...taken];
  }
  return Object.keys(cells).length === 0 ? null : { source: source(second.value), cells };
});

/** The errors if the choice were taken; null if nothing is ticked, or until they are known. */
export const outcome = scoped<ChoiceScores | null>(null);

const loadChoice = newest(async (given: AskedChoice) => {
  const reply = await request("choice", given);
  outcome.value = reply === null ? null : reply.head;
});

effect(() => {
  void settled.value.revision;
  if (screen.value === "results" && choice.value !== null && changes.value.length > 0) loadChoice(choice.value);
  else outcome.value = null;
});

/** Take the ticked values of the second set into the present ones. */
export async function take(): Promise<void> {
  if (choice.value === null || outcome.value === null) return;
  const title = `Took ${countText(outcome.value.count)} of ${nameOfSet(second.value)}`;
  if ((await request("accept", { ...choice.value, title })) !== null) message.value = title;
}

export const countText = (count: number): string => `${count} value${count === 1 ? "" : "s"}`;

/** Take all values of the last run. */
export async function accept(): Promise<void> {
  const run = state.value.runs.at(-1)?.number;
  const cells = Object.fromEntries(state.value.parameters.filter((p) => p.free).map((p) => [p.name, null]));
  const title = `Took all values of run ${run}`;
  if ((await request("accept", { source: { from: run! }, cells, title })) !== null) message.value = title;
}
