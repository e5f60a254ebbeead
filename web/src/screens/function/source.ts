// The function of the project: its file, and what the import of a Simulink or an ASCET model says of it.

import { computed, effect } from "@preact/signals";

import { newest } from "../../connection";
import { holdsFunctions, isHeader } from "../../function-files";
import type { ImportablePart, ImportedFunction, Path, Toml } from "../../replies";
import { scoped } from "../../scope";
import { setKeys, valueAt } from "../../settings";
import { failure, message, request, screen, state } from "../../store";
import { upload } from "../../uploads";

export const functionFile = computed(() => String(valueAt(["model", "file"]) ?? ""));
export const simulink = computed(() => state.value.function.screen === "diagram");
export const esdl = computed(() => state.value.function.screen === "program");
export const files = scoped<string[]>([]); // of the project's folder that can be the function
export const diagram = scoped<ImportedFunction | null>(null);
export const program = scoped<ImportedFunction | null>(null);
export const parts = scoped<ImportablePart[] | null>(null);
export const chosen = scoped(""); // path of a block, or name of a node of formula text

const shown = computed(() => screen.value === "function" && state.value.project !== null);
const textRevision = computed(() => state.value.textRevision);

const loadFiles = newest(async (_: number) => {
  const reply = await request("functions");
  if (reply !== null) files.value = reply.head.files;
});

const loadDiagram = newest(async (_: number) => {
  const reply = await request("diagram");
  if (reply === null) return;
  diagram.value = reply.head;
  const answer = await request("parts");
  parts.value = answer === null ? [] : answer.head.parts;
});

const loadProgram = newest(async (_: number) => {
  const reply = await request("program");
  if (reply !== null) program.value = reply.head;
});

effect(() => {
  if (shown.value) loadFiles(textRevision.value);
});
effect(() => {
  if (!shown.value) return;
  if (simulink.value) loadDiagram(textRevision.value);
  else diagram.value = parts.value = null;
});
effect(() => {
  if (!shown.value) return;
  if (esdl.value) loadProgram(textRevision.value);
  else program.value = null;
});

/** The texts of a list, or the only one. */
export function textsAt(path: Path): string[] {
  const value: Toml | undefined = valueAt(path);
  return (Array.isArray(value) ? value : value === undefined ? [] : [value]).filter(
    (each): each is string => typeof each === "string",
  );
}

/** Add names to a list of the project file, or remove them. */
export function setTexts(path: Path, names: string[], title: string): void {
  void setKeys([[path, names.length === 0 ? null : names]], title);
}

export const choose = (file: string): void => {
  void request("choose-function", { file });
};

const MODEL = /\.(slx|mdl|slxp|kf)$/i;
const ESDL = /\.(esdl|app)$/i;

/** Take over files from the user's machine: a model or formula becomes the function, others give values to a model. */
export async function takeFiles(dropped: File[]): Promise<void> {
  const function_ = dropped.find((file) => MODEL.test(file.name));
  const sources = dropped.filter(
    (file) => ESDL.test(file.name) || (function_ === undefined && (holdsFunctions(file.name) || isHeader(file.name))),
  );
  const others = dropped.filter((file) => file !== function_ && !sources.includes(file));
  if (function_ !== undefined && state.value.project === null) return newFrom(function_);
  if (function_ !== undefined && !(await openFunction(function_))) return;
  if (sources.length > 0 && !(await addSources(sources))) return;
  if (others.length === 0) return;
  if (!simulink.value && function_ === undefined) {
    failure.value = `${others[0]!.name}: drop recordings on Data; here, formula text, models, and functions of other tools can be dropped.`;
    return;
  }
  await addValueFiles(others);
}

/**
 * Store files of an ASCET project by their packages, or functions of other tools; one of them becomes the function,
 * unless they add to an ASCET model.
 */
export async function addSources(added: File[]): Promise<boolean> {
  if (state.value.project === null && (await request("new", { name: added[0]!.name, free: true })) === null)
    return false;
  const names = await upload(added);
  if (names.length === 0 || (await request("add-files", { files: names })) === null) return false;
  message.value = `Added ${added.length === 1 ? added[0]!.name : `${added.length} files`}`;
  return true;
}

/** Begin a project named after a model or formula text, with it as the function. */
export async function newFrom(file: File): Promise<void> {
  if ((await request("new", { name: file.name.replace(/\.\w+$/, "") })) !== null) await openFunction(file);
}

/** Store formula text or a model beside the project, and use it. */
export async function openFunction(file: File): Promise<boolean> {
  if (ESDL.test(file.name)) return addSources([file]);
  const [stored] = await upload([file]);
  if (stored === undefined || (await request("choose-function", { file: stored })) === null) return false;
  message.value = `The function is ${stored}`;
  screen.value = "function";
  return true;
}

/** Store files with values of variables beside the project, and name them. */
export async function addValueFiles(added: File[]): Promise<void> {
  const names = await upload(added);
  setTexts(
    ["model", "parameters"],
    [...textsAt(["model", "parameters"]), ...names],
    `Values from ${added.map((file) => file.name).join(", ")}`,
  );
}

/** Store libraries beside the model, and import it again. */
export async function addLibraries(added: File[]): Promise<void> {
  if ((await upload(added)).length < added.length) return;
  if ((await request("reread-function")) !== null) message.value = `Added ${added.map((file) => file.name).join(", ")}`;
}
