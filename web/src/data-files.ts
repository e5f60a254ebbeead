// The data as a whole: files with their errors, lines of the channels that the function reads, and one channel in full.

import { computed, effect, type Signal } from "@preact/signals";
import { newest } from "./connection";
import { criterionNumber } from "./plots";
import type {
  AskedFileLines,
  ChannelRow,
  DatasetFiles,
  FileErrors,
  FileErrorsArrays,
  FileRow,
  MappedInput,
  RecordingFile,
  ScanReply,
  SignalFacts,
  SignalName,
} from "./replies";
import { scoped } from "./scope";
import { setKeys, valueAt } from "./settings";
import { blocking, request, screen, settled } from "./store";

export interface Lines {
  signals: SignalFacts[];
  lines: Record<string, Float32Array>;
}
export interface Scan extends ScanReply {
  shifts: Float32Array;
  rmse: Float32Array;
}

const LINE = 240; // pixels of the small lines of a row, over all files
const PREVIEW = 900; // and of the preview

export const entries = scoped<DatasetFiles[]>([]);
export const inputs = scoped<MappedInput[]>([]);
export const errors = scoped<FileErrors | null>(null);
export const errorLines = scoped<FileErrorsArrays | null>(null);
export const small = scoped<Lines | null>(null); // of the mapped channels, in their order
export const preview = scoped<Lines | null>(null);
export const scans = scoped<Record<string, Scan>>({}); // by channel
export const chosen = scoped("");
export const chosenFile = scoped(0); // among the rows of `errors`
export const search = scoped("");
export const shownRows = scoped<"all" | "mapped" | "problems" | "not used">("all");

export const fileCount = computed(() => Math.max(1, errors.value?.files.length ?? 1));
const pixels = (all: number): number => Math.max(8, Math.round(all / fileCount.value));

const loadFiles = newest(async (_: number) => {
  const reply = await request("files");
  if (reply === null) return;
  entries.value = reply.head.datasets;
  inputs.value = reply.head.inputs;
});

const loadErrors = newest(async ([criterion]: [number, number]) => {
  const reply = await request("file-errors", { criterion, pixels: 300 });
  if (reply === null) return;
  errors.value = reply.head;
  errorLines.value = reply.arrays;
});

const loaderOf = (lines: Signal<Lines | null>) =>
  newest(async (asked: AskedFileLines) => {
    const reply = await request("file-lines", asked);
    if (reply !== null) lines.value = { signals: reply.head.signals, lines: reply.arrays };
  });
const loadSmall = loaderOf(small);
const loadPreview = loaderOf(preview);

const active = computed(() => screen.value === "data" && settled.value.project !== null);
const evaluable = computed(() => active.value && settled.value.datasets.length > 0 && blocking.value === null);
/** Changes with the project, not with its values. */
const textRevision = computed(() => settled.value.textRevision);

effect(() => {
  if (active.value) loadFiles(textRevision.value);
});
effect(() => {
  if (evaluable.value && settled.value.criteria.length > 0) loadErrors([criterionNumber.value, settled.value.revision]);
});

/** Channels that the function reads or that are targets, each once. */
export const mapped = computed(() => [...new Set(inputs.value.map((each) => each.channel))]);

/** The recorded channels, each with its range over all files. */
export const recorded = computed(() => {
  const channels = new Map<string, ChannelRow>();
  for (const own of entries.value.flatMap((entry) => entry.files.flatMap((file) => file.channels))) {
    const known = channels.get(own.name);
    if (known === undefined || known.least === null) channels.set(own.name, own);
    else if (own.least !== null)
      channels.set(own.name, {
        ...known,
        least: Math.min(known.least, own.least),
        greatest: Math.max(known.greatest!, own.greatest!),
      });
  }
  return channels;
});

const signalOf = (name: string): SignalName => ({
  kind: "channel",
  name,
  unit: recorded.value.get(name)?.unit ?? "",
});

export const shownChannel = computed(() =>
  chosen.value && (mapped.value.includes(chosen.value) || recorded.value.has(chosen.value))
    ? chosen.value
    : (mapped.value[0] ?? ""),
);

/** A question for lines as text, so that an equal one of the same project is not asked again; empty for no channels. */
function keyOf(names: readonly string[], all: number): string {
  if (!evaluable.value || names.length === 0) return "";
  const asked: AskedFileLines = { signals: names.map(signalOf), pixels: pixels(all) };
  return JSON.stringify([textRevision.value, asked]);
}
const questionOf = (key: string): AskedFileLines => (JSON.parse(key) as [number, AskedFileLines])[1];

const smallKey = computed(() => keyOf(mapped.value.slice(0, 100), LINE));
const previewKey = computed(() => keyOf(shownChannel.value ? [shownChannel.value] : [], PREVIEW));

effect(() => {
  if (smallKey.value) loadSmall(questionOf(smallKey.value));
});
effect(() => {
  if (previewKey.value) loadPreview(questionOf(previewKey.value));
});
effect(() => {
  void settled.value.revision; // a scan holds for the present values
  scans.value = {};
});

/** Ask how the error depends on the shift of a channel. */
export async function scanShift(channel: string): Promise<void> {
  const reply = await request("shift-scan", { channel, criterion: criterionNumber.value });
  if (reply !== null) scans.value = { ...scans.value, [channel]: { ...reply.head, ...reply.arrays } };
}

/** The row of errors that belongs to a file of a dataset, with its number. */
export function errorsOf(entry: DatasetFiles, file: RecordingFile): [FileRow, number] | null {
  const dataset = settled.value.datasets.findIndex((each) => each.number === entry.number);
  const rows = errors.value?.files ?? [];
  const at = rows.findIndex(
    (row) => row.dataset === dataset && (file.name === row.name || file.name.endsWith(row.name)),
  );
  return at < 0 ? null : [rows[at]!, at];
}

/** The shift of a channel in the project file: a number, "auto", 0 without one; null if datasets differ. */
export function shiftOf(channel: string): number | "auto" | null {
  const values = settled.value.datasets.map((each) => valueAt(["dataset", each.number, "shift", channel]) ?? 0);
  const first = values[0] ?? 0;
  if (values.some((each) => each !== first)) return null;
  return first === "auto" ? "auto" : Number(first);
}

/** Shift a channel in all datasets; 0 removes the key. */
export function setShift(channel: string, shift: number | "auto"): void {
  const value = shift === 0 ? null : shift;
  void setKeys(
    settled.value.datasets.map((each) => [["dataset", each.number, "shift", channel], value]),
    `${channel}: shift ${shift}${shift === "auto" ? "" : " s"}`,
  );
}

/** Add to the shift of a channel in all datasets. */
export function addShift(channel: string, by: number): void {
  const changes = settled.value.datasets.map((each) => {
    const present = Number(valueAt(["dataset", each.number, "shift", channel]) ?? 0) || 0;
    const next = Number((present + by).toPrecision(6));
    return [["dataset", each.number, "shift", channel], Math.abs(next) < 1e-9 ? null : next] as [
      (string | number)[],
      number | null,
    ];
  });
  void setKeys(changes, `${channel}: shifted by ${Number(by.toPrecision(4))} s`);
}
