// Runs: how they are started, and what they say at their end.

import { effect, signal } from "@preact/signals";
import { newest } from "./connection";
import { isRunning, request, screen, settled, state } from "./store";

export interface Result {
  run: number; status: string; message: string; quality: string[][]; distances: [number, number | null][]; warnings: string[];
  shifts: { dataset: string; channel: string; shift: number }[]; smoothness: { parameter: string; factors: Record<string, number> }[];
  breakpoints: { axis: string; before: number[]; after: number[] }[]; extrapolations: string[];
  free: number; fixed: number; iterations: number; evaluations: number; seconds: Record<string, number>; resumed: string[];
}
export interface Folds { table: string[][]; summary: string[] }
export interface Outcome { resumable: string; result: Result | null; validation: Folds | null }

export const outcome = signal<Outcome>({ resumable: "", result: null, validation: null });
export const view = signal("tables"); // the lower pane of the optimization
export const workers = signal<number | null>(null); // processes for several starts; null is one per core

const load = newest(async (_: string) => {
  const reply = await request("outcome");
  if (reply !== null) outcome.value = reply.head as unknown as Outcome;
});

effect(() => {
  const { revision, project, runs } = settled.value;
  const { job } = state.value;
  if (screen.value === "optimization" && project !== null && !isRunning(job)) load(`${revision} ${runs.length} ${job.state}`);
});

export const running = (): boolean => isRunning(state.value.job);

/** Start a calibration from the present values. */
export const run = (): void => void request("run", workers.value === null ? {} : { workers: workers.value });

/** Continue an interrupted run from its checkpoints. */
export const resume = (): void => void request("run", { resume: true, ...(workers.value === null ? {} : { workers: workers.value }) });

/** Fit every part of the data without one, and score it there. */
export const validate = (folds: number, parts: string): void => void request("run", { folds, parts });
