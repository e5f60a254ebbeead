// Two sets of values side by side, and which values of the last run are accepted.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "./connection";
import type { Change as KeyChange } from "./settings";
import { request, screen, settled, state, type Axis } from "./store";

export interface Change { name: string; kind: string; unit: string; description: string; largest: number; mean: number; relative: number; atBound: number; axes: Axis[]; first: number[]; second: number[]; biggest: number[]; bound: number[] }
export interface ComparedScore { use: string; unit: string; criterion: string; first: number | null; second: number | null; largest: number | null }
export interface Remedy { kind: string; title: string; changes: KeyChange[]; applied: boolean }
export interface Direction { sentence: string; remedy: string; remedies: Remedy[]; exact: boolean; deviation: number | null; parameters: string[] }
export interface Trust { directions: Direction[]; sentence: string; advice: string; remark: string; remedies: Remedy[]; holdings: string[]; noise: { criterion: string; value: number | null }[]; freedom: number | null; values: number }

const NOTHING: Trust = { directions: [], sentence: "", advice: "", remark: "", remedies: [], holdings: [], noise: [], freedom: null, values: 0 };

export const first = signal("start");
export const second = signal("now");
export const changes = signal<Change[]>([]);
export const scores = signal<ComparedScore[]>([]);
export const trust = signal<Trust>(NOTHING);
export const chosen = signal("");
export const rejected = signal<Record<string, Set<number>>>({}); // cells that keep their start, by parameter

export const shown = computed(() => changes.value.find((each) => each.name === chosen.value) ?? changes.value[0]);

const load = newest(async (_: string) => {
  const [compared, known] = await Promise.all([request("compare", { first: first.value, second: second.value }), request("trust")]);
  if (compared !== null) {
    changes.value = compared.head.changes as Change[];
    scores.value = compared.head.scores as ComparedScore[];
  }
  if (known !== null) trust.value = { ...NOTHING, ...(known.head as unknown as Trust) };
});

effect(() => {
  const { revision, project, runs } = settled.value;
  if (screen.value !== "results" || project === null) return;
  load(`${revision} ${runs.length} ${first.value} ${second.value}`);
});

/** Take the values of the last run, but for those that keep their start. */
export function accept(): void {
  const run = state.value.runs.at(-1)!.number;
  const cells: Record<string, number[] | null> = {};
  for (const each of changes.value) {
    const kept = rejected.value[each.name];
    if (!kept?.size) cells[each.name] = null;
    else if (kept.size < each.first.length) cells[each.name] = each.first.map((_, k) => k).filter((k) => !kept.has(k));
  }
  void request("accept", { run, cells, title: `Accepted run ${run}` });
}
