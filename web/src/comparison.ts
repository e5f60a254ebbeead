// Two sets of values side by side, and which values of the last run are accepted.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "./connection";
import type { AskedChoice, ComparedScore, ComparedTable, TrustReply } from "./replies";
import { scoped } from "./scope";
import { request, screen, settled, state } from "./store";

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

export const first = scoped("start");
export const second = scoped("now");
export const changes = scoped<ComparedTable[]>([]);
export const scores = scoped<ComparedScore[]>([]);
/** The remedy whose effect is shown, by its title. */
export const tried = scoped("");
export const trust = scoped<Required<TrustReply>>(NOTHING);
export const chosen = scoped("");
export const rejected = scoped<Record<string, Set<number>>>({}); // cells that keep their start, by parameter

export const shown = computed(() => changes.value.find((each) => each.name === chosen.value) ?? changes.value[0]);

const load = newest(async (_: string) => {
  const [compared, known] = await Promise.all([
    request("compare", { first: first.value, second: second.value }),
    request("trust"),
  ]);
  if (compared !== null) {
    changes.value = compared.head.changes;
    scores.value = compared.head.scores;
  }
  if (known !== null) trust.value = { ...NOTHING, ...known.head };
});

effect(() => {
  const { revision, project, runs } = settled.value;
  if (screen.value !== "results" || project === null) return;
  load(`${revision} ${runs.length} ${first.value} ${second.value}`);
});

export const ranking = signal<"max" | "mean">("max");

/** Tables with the biggest change first. */
export const ranked = computed(() =>
  ranking.value === "max"
    ? changes.value
    : changes.value.toSorted(
        (a, b) => (b.mean / (b.largest || 1)) * b.relative - (a.mean / (a.largest || 1)) * a.relative,
      ),
);

export const keptCount = computed(() => Object.values(rejected.value).reduce((sum, cells) => sum + cells.size, 0));
export const valueCount = computed(() => changes.value.reduce((sum, each) => sum + each.first.length, 0));

/** Keep the start of every value, or of none. */
export function keepAll(keep: boolean): void {
  rejected.value = keep
    ? Object.fromEntries(changes.value.map((each) => [each.name, new Set(each.first.map((_, k) => k))]))
    : {};
}

/** RMSE on training data if the choice were accepted; null if all is accepted. */
export const choiceScore = scoped<{ rmse: number | null; unit: string } | null>(null);

const loadChoice = newest(async (given: AskedChoice) => {
  const reply = await request("choice", given);
  const own = reply?.head.scores.find((each) => each.use === "training");
  choiceScore.value = own === undefined ? null : { rmse: own.rmse, unit: reply?.head.unit ?? "" };
});

effect(() => {
  const run = settled.value.runs.at(-1)?.number;
  if (screen.value === "results" && run !== undefined && keptCount.value > 0) loadChoice({ run, cells: cellsOf() });
  else choiceScore.value = null;
});

/** Take the values of the last run, but for those that keep their start. */
export function accept(): void {
  const run = state.value.runs.at(-1)!.number;
  void request("accept", { run, cells: cellsOf(), title: `Accepted run ${run}` });
}

/** The accepted values by table; null is all of them. */
function cellsOf(): Record<string, number[] | null> {
  const cells: Record<string, number[] | null> = {};
  for (const each of changes.value) {
    const kept = rejected.value[each.name];
    if (!kept?.size) cells[each.name] = null;
    else if (kept.size < each.first.length) cells[each.name] = each.first.map((_, k) => k).filter((k) => !kept.has(k));
  }
  return cells;
}
