// Runs: how they are started, and what they say at their end.

import { effect, signal } from "@preact/signals";
import { newest } from "./connection";
import type { RunOutcome } from "./replies";
import { scoped } from "./scope";
import { isRunning, request, screen, settled, state } from "./store";

export const outcome = scoped<RunOutcome>({ resumable: "", result: null, validation: null, files: 0 });
export const view = signal("tables"); // the lower pane of the optimization
export const workers = scoped<number | null>(null); // processes for several starts; null is one per core

const load = newest(async (_: string) => {
  const reply = await request("outcome");
  if (reply !== null) outcome.value = reply.head;
});

effect(() => {
  const { revision, project, runs } = settled.value;
  const { job } = state.value;
  if (screen.value === "optimization" && project !== null && !isRunning(job))
    load(`${revision} ${runs.length} ${job.state}`);
});

export const running = (): boolean => isRunning(state.value.job);

/** Start a calibration from the present values. */
export const run = (): void => void request("run", workers.value === null ? {} : { workers: workers.value });

/** Continue an interrupted run from its checkpoints. */
export const resume = (): void =>
  void request("run", { resume: true, ...(workers.value === null ? {} : { workers: workers.value }) });

/** Fit every part of the data without one, and score it there. */
export const validate = (folds: number, parts: string): void => void request("run", { folds, parts });
