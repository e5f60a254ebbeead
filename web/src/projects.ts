// Projects on the start page: recent ones, the demos, and new ones from files that are dropped.

import { computed, effect, signal } from "@preact/signals";
import { holdsFunctions } from "./function-files";
import type { KnownProjects, Questions } from "./replies";
import { save } from "./saving";
import { clock } from "./spoken";
import { message, request, type Screen, screen, state } from "./store";
import { upload } from "./uploads";

export const known = signal<KnownProjects>({ recent: [], demos: [], folder: "", version: "" });
export const chosen = signal("");
export const filter = signal("");
export const opening = signal(false);

const openPath = computed(() => state.value.project?.path ?? "");

export async function loadProjects(): Promise<void> {
  const reply = await request("projects");
  if (reply !== null) known.value = reply.head;
}

effect(() => {
  void openPath.value;
  if (screen.value === "start") void loadProjects();
});

/** Projects whose name, path or node contain every word of the filter. */
export const shownProjects = computed(() => {
  const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
  return known.value.recent.filter((each) =>
    words.every((word) => `${each.name} ${each.path} ${each.node ?? ""}`.toLowerCase().includes(word)),
  );
});

export const selected = computed(
  () => shownProjects.value.find((each) => each.path === chosen.value) ?? shownProjects.value[0],
);

/** What is to be done once it is decided what becomes of the unsaved edits of the present project; null if nothing. */
export const leaving = signal<(() => void) | null>(null);

/** Leave the present project: at once, or once the user has decided what becomes of its unsaved edits. */
function leave(go: () => void): void {
  if (state.value.unsaved.length === 0) go();
  else leaving.value = go;
}

/** Save or take back the edits of the present project, or leave them as they are, and do what was to be done. */
export async function decide(edits: "save" | "keep" | "discard"): Promise<void> {
  const go = leaving.value;
  leaving.value = null;
  if (edits === "save" && !(await save())) return;
  if (edits === "discard" && (await request("discard")) === null) return;
  go?.();
}

export function openProject<Q extends "open" | "demo" | "new">(
  question: Q,
  given: Questions[Q]["asks"],
  next: Screen = "parameters",
): void {
  leave(() => void openAtOnce(question, given, next));
}

async function openAtOnce<Q extends "open" | "demo" | "new">(
  question: Q,
  given: Questions[Q]["asks"],
  next: Screen,
): Promise<void> {
  opening.value = true; // files that are dropped from now on belong to that project
  try {
    if ((await request<"open" | "demo" | "new">(question, given)) !== null) screen.value = next;
  } finally {
    opening.value = false;
  }
}

/** Make a project from dropped files: recordings, a function, or a calibration. */
export function projectFrom(files: File[]): void {
  leave(() => void makeFrom(files));
}

async function makeFrom(files: File[]): Promise<void> {
  // an application names a project of many files
  const first = files.find((file) => /\.app$/i.test(file.name)) ?? files[0];
  if (first === undefined || (await request("new", { name: first.name, free: true })) === null) return;
  screen.value = "data";
  const names = await upload(files);
  if (names.length === 0) return;
  const reply = await request("add-files", { files: names });
  if (reply !== null) message.value = `Added ${files.length === 1 ? first.name : `${files.length} files`}`;
  const kinds = Object.values(reply?.head.kinds ?? {});
  const isFunction = kinds.includes("program") || files.some((file) => holdsFunctions(file.name));
  if (isFunction && !kinds.includes("recording")) screen.value = "function";
}

/** A date as one says it: today 16:52, yesterday, 14 Nov. */
export function spoken(seconds: number, now = new Date()): string {
  if (!seconds) return "";
  const then = new Date(seconds * 1000);
  const days = Math.round(
    (new Date(now.toDateString()).getTime() - new Date(then.toDateString()).getTime()) / 86_400_000,
  );
  if (days === 0) return `today ${clock(seconds)}`;
  if (days === 1) return "yesterday";
  return `${then.getDate()} ${then.toLocaleString("en", { month: "short" })}${then.getFullYear() === now.getFullYear() ? "" : ` ${then.getFullYear()}`}`;
}
