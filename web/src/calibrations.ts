// Calibration files of the folder, and two sets of values that are compared, merged or converted.

import { computed, effect } from "@preact/signals";
import { newest } from "./connection";
import type {
  AskedContents,
  AskedDifferences,
  AskedPair,
  CalibrationFiles,
  LabelPair,
  SetContents,
  SetDifferences,
  SourceName,
  WrittenCalibration,
} from "./replies";
import { scoped } from "./scope";
import { message, request, screen, settled, state } from "./store";
import { upload } from "./uploads";

export const folder = scoped<CalibrationFiles>({ files: [], descriptions: [], endings: [], initial: [] });
export const sides = { first: scoped("now"), second: scoped("start") };
export const descriptions = scoped<Record<string, string>>({}); // the A2L file of an image, by its name
export const tolerance = scoped({ absolute: 0, relative: 0 });
export const comparison = scoped<SetDifferences | null>(null);
export const chosen = scoped("");
export const pair = scoped<LabelPair | null>(null);
export const ticked = scoped(new Set<string>());
export const written = scoped<WrittenCalibration | null>(null);
export const existing = scoped(""); // name of a file that would be replaced
export const opened = scoped<SetContents | null>(null);
export const shown = scoped<"differences" | "contents">("differences");
export const search = scoped("");

const changed = scoped(0); // counts writes and uploads

/** A source as the server names it: "now", "start", the number of a run, or "file:NAME". */
export function source(value: string): SourceName {
  if (!value.startsWith("file:")) return { from: value };
  const name = value.slice(5);
  return { from: "file", file: name, a2l: descriptions.value[name] ?? "" };
}

const loadFolder = newest(async (_: string) => {
  const reply = await request("calibrations");
  if (reply !== null) folder.value = reply.head;
});

const loadComparison = newest(async (given: AskedDifferences) => {
  const reply = await request("differences", given);
  comparison.value = reply === null ? null : reply.head;
  const rows = comparison.value?.rows ?? [];
  if (!rows.some((row) => row.label === chosen.value)) chosen.value = rows[0]?.label ?? "";
  ticked.value = new Set(rows.filter((row) => row.only !== "first").map((row) => row.label));
});

const loadPair = newest(async (given: AskedPair) => {
  const reply = given.name ? await request("pair", given) : null;
  pair.value = reply === null ? null : reply.head;
});

const loadContents = newest(async (given: AskedContents) => {
  const reply = await request("contents", given);
  opened.value = reply === null ? null : reply.head;
});

const hasProject = computed(() => settled.value.project !== null);
const active = computed(() => screen.value === "files" && hasProject.value);
const key = computed(() => `${settled.value.revision} ${settled.value.runs.length} ${changed.value}`);
/** Changes with the files of the folder, not with every edit of a value. */
const listing = computed(
  () =>
    `${settled.value.textRevision} ${settled.value.runs.length} ${changed.value} ${state.value.unsaved.length === 0}`,
);

effect(() => {
  const listed = active.value || screen.value === "results" || screen.value === "parameters";
  if (listed && hasProject.value) loadFolder(listing.value);
});
effect(() => {
  if (!active.value || !key.value) return;
  const [first, second] = [source(sides.first.value), source(sides.second.value)];
  if (shown.value === "contents") loadContents({ source: second });
  else loadComparison({ first, second, tolerance: tolerance.value.absolute, relative: tolerance.value.relative });
});
effect(() => {
  if (active.value && comparison.value !== null)
    loadPair({ first: source(sides.first.value), second: source(sides.second.value), name: chosen.value });
});

/** Store dropped files, and compare the first with the present values; returns those that hold values. */
export async function addFiles(files: File[]): Promise<string[]> {
  const names = await upload(files);
  changed.value++;
  const values = names.filter((name) => !name.toLowerCase().endsWith(".a2l"));
  if (values[0] === undefined) return [];
  sides.second.value = `file:${values[0]}`;
  message.value = `Opened ${values[0]}`;
  return values;
}

/** Take the ticked labels of the second set into the values of the project. */
export async function take(): Promise<string[] | null> {
  const names = (comparison.value?.rows ?? [])
    .filter((row) => row.takeable && ticked.value.has(row.label))
    .map((row) => row.label);
  const reply = await request("take-values", { source: source(sides.second.value), names });
  if (reply === null) return null;
  message.value = `Took ${names.length} parameter${names.length > 1 ? "s" : ""} from ${comparison.value?.labels[1] ?? ""}`;
  return reply.head.findings;
}

/** Write a set, or the first one with the ticked labels of the second, as a file of the folder. */
export async function write(given: {
  merged: boolean;
  target: string;
  image: string;
  a2l: string;
  force: boolean;
}): Promise<void> {
  const first = source(given.merged ? sides.first.value : sides.second.value);
  const more = given.merged ? { second: source(sides.second.value), names: [...ticked.value] } : {};
  const reply = await request("write-calibration", {
    first,
    ...more,
    target: given.target,
    image: given.image,
    a2l: given.a2l,
    force: given.force,
  });
  existing.value = reply !== null && "exists" in reply.head ? reply.head.exists : "";
  if (reply === null || "exists" in reply.head) return;
  written.value = reply.head;
  message.value = `Written to ${written.value.file}`;
  changed.value++;
}
