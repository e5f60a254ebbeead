// The function of the project: its file, and what the import of a Simulink or an ASCET model says of it.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "../../connection";
import { holdsFunctions, isHeader } from "../../function-files";
import type { Path, Toml } from "../../replies";
import { setKeys, valueAt } from "../../settings";
import { failure, message, request, screen, state } from "../../store";
import { upload } from "../../uploads";

export type BlockState = "supported" | "bound" | "undefined" | "unsupported" | "unused" | "unreached";
export interface Block { path: string; name: string; type: string; depth: number; inner: number; field: string; detail: string; state: BlockState }
export interface Line { text: string; node: string; path: string }
export interface Problem { place: string; message: string; remedy: string; text: string }
export interface Blocking { path: string; type: string; why: string; remedy: string; stops: boolean }
export interface Variable { name: string; kind: string; shape: number[]; smallest: number; largest: number; unit: string; lower: number | null; upper: number | null; locked: boolean; source: string }
export interface Part { path: string; blocks: number; inputs: string[]; outputs: string[] }
export interface Diagram {
  file: string; subsystem: string; bind: Record<string, string>; problems: Problem[]; name?: string; version?: string;
  blocks?: Block[]; subsystems?: string[]; lines?: Line[]; files?: string[]; total?: number; supported?: number; unreached?: number; whole?: boolean;
  solver?: string; step?: number | null; blocking?: Blocking[]; undefined?: { name: string; paths: string[]; reason: string }[];
  loops?: string[][]; stopped?: Problem[]; parameters?: Variable[]; inputs?: Port[];
  outputs?: Port[]; notes?: string[];
}

export interface ProgramProblem { source: number; line: number; message: string; remedy: string; text: string }
export interface Program {
  file: string; chosen: { class: string; methods: string[]; tasks: string[] }; sources: { file: string; text: string }[]; problems: ProgramProblem[];
  classes?: { name: string; methods: string[] }[]; tasks?: { name: string; period: number | null; methods: string[] }[];
  whole?: boolean; missing?: string[]; calls?: string[]; startup?: string[]; step?: number | null; schedule?: { name: string; period: number; delay: number; methods: string[] }[];
  inputs?: Port[]; outputs?: Port[]; parameters?: Variable[]; states?: { name: string; initial: number | null }[]; notes?: string[];
  lines?: Line[]; places?: { name: string; source: number; line: number }[];
}
export interface Port { name: string; unit: string }

export const functionFile = computed(() => String(valueAt(["model", "file"]) ?? ""));
export const simulink = computed(() => /\.(slx|mdl|slxp)$/i.test(functionFile.value));
export const esdl = computed(() => /\.(esdl|app)$/i.test(functionFile.value));
export const files = signal<string[]>([]); // of the project's folder that can be the function
export const diagram = signal<Diagram | null>(null);
export const program = signal<Program | null>(null);
export const parts = signal<Part[] | null>(null);
export const chosen = signal(""); // path of a block, or name of a node of formula text

const shown = computed(() => screen.value === "function" && state.value.project !== null);
const textRevision = computed(() => state.value.textRevision);

const loadFiles = newest(async (_: number) => {
  const reply = await request("functions");
  if (reply !== null) files.value = reply.head.files as string[];
});

const loadDiagram = newest(async (_: number) => {
  const reply = await request("diagram");
  if (reply === null) return;
  diagram.value = reply.head as unknown as Diagram;
  const answer = await request("parts");
  parts.value = answer === null ? [] : (answer.head.parts as Part[]);
});

const loadProgram = newest(async (_: number) => {
  const reply = await request("program");
  if (reply !== null) program.value = reply.head as unknown as Program;
});

effect(() => { if (shown.value) loadFiles(textRevision.value); });
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
  return (Array.isArray(value) ? value : value === undefined ? [] : [value]).filter((each): each is string => typeof each === "string");
}

/** Add names to a list of the project file, or remove them. */
export function setTexts(path: Path, names: string[], title: string): void {
  void setKeys([[path, names.length === 0 ? null : names]], title);
}

export const choose = (file: string): void => { void request("choose-function", { file }); };

const MODEL = /\.(slx|mdl|slxp|kf)$/i;
const ESDL = /\.(esdl|app)$/i;

/** Take over files from the user's machine: a model or formula becomes the function, others give values to a model. */
export async function takeFiles(dropped: File[]): Promise<void> {
  const function_ = dropped.find((file) => MODEL.test(file.name));
  const sources = dropped.filter((file) => ESDL.test(file.name) || (function_ === undefined && (holdsFunctions(file.name) || isHeader(file.name))));
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

/** Store files of an ASCET project by their packages, or functions of other tools; one of them becomes the function, unless they add to an ASCET model. */
export async function addSources(added: File[]): Promise<boolean> {
  if (state.value.project === null && (await request("new", { name: added[0]!.name, free: true })) === null) return false;
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
  setTexts(["model", "parameters"], [...textsAt(["model", "parameters"]), ...names], `Values from ${added.map((file) => file.name).join(", ")}`);
}

/** Store libraries beside the model, and import it again. */
export async function addLibraries(added: File[]): Promise<void> {
  if ((await upload(added)).length < added.length) return;
  if ((await request("reread-function")) !== null) message.value = `Added ${added.map((file) => file.name).join(", ")}`;
}
