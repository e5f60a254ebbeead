// The errors of the last run by file, the worst first; folded while every dataset has only one file.

import { computed, effect } from "@preact/signals";
import { newest } from "../../connection";
import { WhatIsMissing } from "../../instruments/what-is-missing";
import type { ErrorsByFile } from "../../replies";
import { scoped } from "../../scope";
import { request, screen, settled } from "../../store";
import { Cells } from "../optimization/outcome";

const answer = scoped<ErrorsByFile>({ run: null, rows: [], more: 0, several: false });
const asked = scoped<boolean | null>(null); // what the user chose, else it depends on the files
const unfolded = computed(() => asked.value ?? answer.value.several);

const load = newest(async (_: string) => {
  const reply = await request("by-file");
  if (reply !== null) answer.value = reply.head;
});

effect(() => {
  const { revision, project, runs } = settled.value;
  if (screen.value === "results" && project !== null) load(`${revision} ${runs.length}`);
});

export function ByFilePane() {
  const { run, rows, more } = answer.value;
  if (run === null || rows.length < 2) return null;
  return (
    <section class={`pane bf ${unfolded.value ? "" : "folded"}`} id="by-file">
      <div class="head">
        <h2>By file</h2>
        <span class="sub">run {run}, worst first</span>
        <span class="right">
          <WhatIsMissing />
          <button
            class="btn small"
            aria-expanded={unfolded.value}
            onClick={() => {
              asked.value = !unfolded.value;
            }}
          >
            {unfolded.value ? "Hide" : "Show"}
          </button>
        </span>
      </div>
      {unfolded.value && (
        <div class="items">
          <Cells rows={rows} id="files-table" />
          {more > 0 && <p class="pad q">{more} further files with smaller errors; result.json has all of them.</p>}
        </div>
      )}
    </section>
  );
}
