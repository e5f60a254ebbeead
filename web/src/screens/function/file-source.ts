// What the page knows of functions in files of other tools: the function of the project, and those that formula text
// calls.

import { computed, effect } from "@preact/signals";
import { newest } from "../../connection";
import { holdsFunctions, isHeader } from "../../function-files";
import type { CalledFunction, ProjectFunction } from "../../replies";
import { scoped } from "../../scope";
import { setKeys } from "../../settings";
import { failure, message, request, screen, state } from "../../store";
import { upload } from "../../uploads";
import { chosen, functionFile } from "./source";

export const isFileFunction = computed(() => state.value.function.screen === "function-file");
export const fileFunction = scoped<ProjectFunction | null>(null);
export const calledFunctions = scoped<CalledFunction[]>([]);

const shown = computed(() => screen.value === "function" && state.value.project !== null);
const textRevision = computed(() => state.value.textRevision);

const loadFunction = newest(async (_: number) => {
  const reply = await request("function-file");
  if (reply !== null) fileFunction.value = reply.head;
});
const loadCalled = newest(async (_: number) => {
  const reply = await request("called-functions");
  if (reply !== null) calledFunctions.value = reply.head.functions;
});

effect(() => {
  void functionFile.value;
  if (isFileFunction.value) chosen.value = "";
});
effect(() => {
  if (!shown.value) return;
  if (isFileFunction.value) loadFunction(textRevision.value);
  else fileFunction.value = null;
});
effect(() => {
  if (shown.value && !isFileFunction.value) loadCalled(textRevision.value);
});

/** Store files beside the project, and let formula text call their functions; headers belong to those of C. */
export async function addCalled(files: File[]): Promise<void> {
  const names = await upload(files);
  const holding = names.filter(holdsFunctions);
  if (holding.length === 0) {
    if (names.some(isHeader)) await request("reread-function");
    else if (names.length > 0) failure.value = `${names[0]} holds no functions; use .fmu, .onnx, .c or .py.`;
    return;
  }
  const reply = await request("add-functions", { files: holding });
  if (reply !== null) message.value = `Formula text can call ${reply.head.names.join(", ")}`;
}

/** Call another function of the file of a called function. */
export const setCalled = (own: CalledFunction, name: string): void => {
  void setKeys([[["functions", own.name], `${own.file}:${name}`]], `${own.name} is ${name} of ${own.file}`);
};
