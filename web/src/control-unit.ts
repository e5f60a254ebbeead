// Into the control unit: how values are stored and rounded, the code with them, and the files that are written.

import { computed, effect } from "@preact/signals";
import { source as sourceOf } from "./calibrations";
import { newest } from "./connection";
import { flipped } from "./flipped";
import type { AskedCode, CodeReply, ControlUnit, FinerRow, RoundingReply, UnitCommand, WrittenUnit } from "./replies";
import { scoped } from "./scope";
import { message, request, screen, settled } from "./store";

export type Method = "nearest" | "joint";
export type Precision = "double" | "float";
type Language = UnitCommand["languages"][number];
type Platform = NonNullable<UnitCommand["platforms"]>[number];

export const unit = scoped<ControlUnit | null>(null);
/** The set that is written: "now", "start" or the number of a run. */
export const source = scoped("now");
const picked = scoped<Method | null>(null);
export const precision = scoped<Precision>("double");
export const name = scoped(""); // of the code; empty for that of the function

interface Kept<T> {
  key: string; // what it was computed for
  reply: T;
}
const kept = scoped<Kept<RoundingReply> | null>(null);
export const finer = scoped<FinerRow[]>([]);
/** What is being computed, in words; empty if nothing is. */
export const busy = scoped("");
const keptCode = scoped<Kept<CodeReply> | null>(null);

export const method = computed<Method>(() => picked.value ?? (unit.value?.method || "joint"));
const revisionKey = computed(() => `${settled.value.revision} ${source.value}`);
const roundingKey = computed(() => `${revisionKey.value} ${method.value}`);

/** True if steps are known, so that what is written is rounded. */
export const rounds = computed(() => (unit.value?.method ?? "") !== "");
export const rounded = computed(() => kept.value?.reply ?? null);
export const roundingStale = computed(() => kept.value !== null && kept.value.key !== roundingKey.value);

/** Why nothing is written yet; empty if it can be. */
export const waitsFor = computed(() => {
  if (!rounds.value || (kept.value !== null && !roundingStale.value)) return "";
  return kept.value === null ? "Round first" : "Round again first";
});
const applied = computed(() => (rounds.value ? method.value : ""));

const loadUnit = newest(async (_: string) => {
  const reply = await request("control-unit");
  if (reply !== null) unit.value = reply.head;
});

const isShown = computed(
  () =>
    screen.value === "control-unit" &&
    settled.value.project !== null &&
    settled.value.parameters.length > 0 &&
    settled.value.criteria.length > 0,
);

effect(() => {
  const { revision } = settled.value;
  if (isShown.value) loadUnit(`${revision}`);
});

/** Switch between the methods; what is shown is computed anew, unless nothing was rounded yet. */
export function chooseMethod(next: Method): void {
  if (next === method.value) return;
  picked.value = next;
  if (kept.value !== null) void round();
}

export async function round(): Promise<void> {
  const key = roundingKey.value;
  const given = { source: sourceOf(source.value), method: method.value };
  busy.value = "rounding";
  finer.value = [];
  const reply = await request("rounding", given);
  busy.value = "";
  if (reply === null || key !== roundingKey.value) return;
  kept.value = { key, reply: reply.head };
  for (const [at, labels] of reply.head.trials.entries()) {
    busy.value = `trying finer storage, ${at + 1} of ${reply.head.trials.length}`;
    const trial = await request("finer-storage", { ...given, labels });
    if (trial === null || key !== roundingKey.value) break; // the values have changed meanwhile
    finer.value = [...finer.value, trial.head];
  }
  busy.value = "";
}

/** Set steps of parameters, null to remove one. */
export async function setSteps(steps: Record<string, number | null>): Promise<void> {
  if ((await request("set-storage", { steps })) !== null) message.value = `Step of ${Object.keys(steps).join(", ")}`;
}

/** Take the storage that an A2L file states; empty for none. */
export async function setStorage(storage: string): Promise<void> {
  if ((await request("set-storage", { steps: {}, storage })) !== null)
    message.value = storage ? `Storage as in ${storage}` : "No storage from a file";
}

const asked = computed<Required<AskedCode>>(() => ({
  source: sourceOf(source.value),
  rounding: applied.value,
  precision: precision.value,
  name: name.value,
  check: false,
}));
const codeKey = computed(() => `${revisionKey.value} ${applied.value} ${precision.value} ${name.value}`);

export const code = computed(() => keptCode.value?.reply ?? null);
export const codeStale = computed(() => keptCode.value !== null && keptCode.value.key !== codeKey.value);

const loadCode = newest(async (key: string) => {
  const reply = await request("code", asked.peek());
  if (reply !== null && key === codeKey.value) keptCode.value = { key, reply: reply.head };
});

effect(() => {
  // the values of the file are those that were rounded
  if (isShown.value && unit.value !== null && waitsFor.value === "" && keptCode.peek()?.key !== codeKey.value)
    loadCode(codeKey.value);
});

/** Compile the code and compare it with the simulation over all data. */
export async function compareCode(): Promise<void> {
  const key = codeKey.value;
  busy.value = "compiling and comparing";
  const reply = await request("code", { ...asked.value, check: true });
  busy.value = "";
  if (reply !== null && key === codeKey.value) keptCode.value = { key, reply: reply.head };
}

export const languages = scoped<ReadonlySet<Language>>(new Set<Language>(["c"]));
const pickedFormats = scoped<ReadonlySet<string> | null>(null);
export const formats = computed(() => pickedFormats.value ?? new Set(unit.value?.own ?? []));
export const fmi = scoped<2 | 3>(2);
export const platforms = scoped<Platform[]>([]); // for which the FMU has a library beside that of this computer
export const inputs = scoped<"start" | "end">("end");
export const step = scoped<number | null>(null);
export const folder = scoped("");
export const existing = scoped<string[]>([]); // files that would be replaced
export const written = scoped<WrittenUnit | null>(null);

/** What the function calculates over all data is written, too. */
export const signals = scoped(false);

export const chosenCount = computed(() => languages.value.size + formats.value.size + Number(signals.value));

/** Tick a language or a format, or take the tick away. */
export function flipLanguage(own: Language): void {
  languages.value = flipped(languages.value, own);
  existing.value = [];
}

export function flipFormat(own: string): void {
  pickedFormats.value = flipped(formats.value, own);
  existing.value = [];
}

/** Write what is ticked: all files, or none. */
export async function writeFiles(force: boolean): Promise<void> {
  busy.value = "writing";
  const reply = await request("write-unit", {
    source: sourceOf(source.value),
    rounding: applied.value,
    languages: [...languages.value],
    formats: [...formats.value],
    precision: precision.value,
    name: name.value,
    fmi: fmi.value,
    platforms: platforms.value,
    inputs: inputs.value,
    step: step.value,
    folder: folder.value || unit.value!.folder,
    signals: signals.value,
    force,
  });
  busy.value = "";
  if (reply === null) return;
  if ("existing" in reply.head) {
    existing.value = reply.head.existing;
    return;
  }
  existing.value = [];
  written.value = reply.head;
  message.value = `Written: ${reply.head.files.length} files`;
}

/** What was written, for the rail. */
export const detail = computed(() => {
  const count = written.value?.files.length ?? 0;
  return count === 0 ? "nothing written yet" : count === 1 ? "1 file written" : `${count} files written`;
});
