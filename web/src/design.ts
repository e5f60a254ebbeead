// What to measure next: the question, the last design, and the table and segment that are shown of it.

import { computed, effect } from "@preact/signals";
import { newest, type Reply } from "./connection";
import { significant } from "./drawing/numbers";
import { flipped } from "./flipped";
import type { DesignExport, Designs } from "./replies";
import { scoped } from "./scope";
import { message, request, screen, settled, state } from "./store";

export type Recorded = "drive" | "points" | "drop";
export type Shown = "deviation" | "value" | "gain";
export type Format = DesignExport["format"];

export const designs = scoped<Designs | null>(null);
const picked = scoped<Recorded | null>(null);
/** Numbers of segments, points, and recordings that are kept; null for the usual number. */
export const counts = {
  drive: scoped<number | null>(null),
  points: scoped<number | null>(null),
  drop: scoped<number | null>(null),
};
export const candidates = scoped("");
/** Parameters that points should determine; none for the whole function. */
export const names = scoped<ReadonlySet<string>>(new Set());
/** The direction that points should determine, from 1; 0 for none. */
export const direction = scoped(0);
const chosenTable = scoped("");
export const segment = scoped(0);
export const shown = scoped<Shown>("deviation");
export const map = scoped<Reply<"design-map"> | null>(null);
export const format = scoped<Format>("csv");
export const existing = scoped("");
export const written = scoped("");

export const recorded = computed<Recorded>(() => picked.value ?? (designs.value?.timed ? "drive" : "points"));
export const computing = computed(() => state.value.design.state === "running");
export const outcome = computed(() => designs.value?.found ?? null);
export const table = computed(
  () => outcome.value?.tables.find((each) => each.name === chosenTable.value) ?? outcome.value?.tables[0] ?? null,
);

/** A deviation in words; "open" for one that nothing determines. */
export const deviationText = (value: number | null): string => (value === null ? "open" : significant(value, 3));

export function chooseRecorded(own: Recorded): void {
  picked.value = own;
}

export function chooseTable(name: string): void {
  chosenTable.value = name;
}

const isShown = computed(() => screen.value === "design" && settled.value.project !== null);

const load = newest(async (_: string) => {
  const reply = await request("designs");
  if (reply === null) return;
  designs.value = reply.head;
  const formats = reply.head.found?.formats ?? [];
  if (formats.length > 0 && !formats.includes(format.value)) format.value = formats[0]!;
});

const workKey = computed(() => {
  const { state: own, seconds } = state.value.design;
  return own === "running" ? own : `${own} ${seconds}`;
});

effect(() => {
  const { revision, runs } = settled.value;
  if (isShown.value) load(`${revision} ${runs.length} ${workKey.value}`);
});

const loadMap = newest(async (name: string) => {
  const reply = await request("design-map", { name });
  if (reply !== null) map.value = reply;
});

effect(() => {
  void outcome.value;
  if (isShown.value && table.value !== null) loadMap(table.value.name);
  else map.value = null;
});

/** Show the way to settle a direction that the data of the last run do not determine. */
export function settle(number: number): void {
  direction.value = number;
  names.value = new Set();
  if (number > 0) picked.value = "points";
  screen.value = "design";
}

export function flipName(name: string): void {
  names.value = flipped(names.value, name);
  direction.value = 0;
}

/** The first question of a project: what a drive, points or recordings would settle. */
export async function propose(): Promise<void> {
  if (computing.value) return;
  const own = recorded.value;
  const isPoints = own === "points";
  existing.value = written.value = "";
  segment.value = 0;
  await request("propose-design", {
    segments: own === "drive" ? (counts.drive.value ?? (hasManoeuvres() ? null : 15)) : null,
    points: isPoints ? (counts.points.value ?? 20) : null,
    reduce: own === "drop",
    keep: own === "drop" ? counts.drop.value : null,
    candidates: own === "drop" ? [] : candidates.value.split(/[,;]\s*|\s{2,}/).filter(Boolean),
    names: isPoints ? [...names.value] : [],
    direction: isPoints && direction.value > 0 ? direction.value : null,
  });
}

/** True if a project without data plans manoeuvres, which are listed whole. */
const hasManoeuvres = (): boolean => settled.value.parameters.length === 0;

export async function exportDesign(force: boolean): Promise<void> {
  const reply = await request("export-design", { format: format.value, force });
  if (reply === null) return;
  existing.value = "existing" in reply.head ? reply.head.existing[0]! : "";
  if ("existing" in reply.head) return;
  written.value = reply.head.file;
  message.value = `Written: ${reply.head.file}`;
}

/** Choose the segment before or after. */
export function step(by: number): void {
  const last = Math.max(outcome.value?.segments.length ?? 0, outcome.value?.points.length ?? 0) - 1;
  segment.value = Math.max(0, Math.min(last, segment.value + by));
}
