// Beside the course of a run: the number of processes, and the offer to resume an interrupted run.

import { parseNumber } from "../../drawing/numbers";
import { outcome, resume, running, workers } from "../../runs";

export function RunOptions() {
  const { resumable } = outcome.value;
  const idle = !running();
  return (
    <>
      {idle && resumable && (
        <span class="resume">
          <span class="warn cut" title={resumable}>
            {resumable}
          </span>{" "}
          <button
            class="btn small"
            id="resume"
            title="Continue from its checkpoints (kennfeld calibrate --resume)"
            onClick={resume}
          >
            Resume
          </button>
        </span>
      )}
      {idle && (
        <label title="Number of processes for several starts (kennfeld calibrate --workers); empty: one per core">
          <span class="q">Processes</span>{" "}
          <span class="field small num" style={{ width: "40px" }}>
            <input
              aria-label="Processes"
              placeholder="auto"
              value={workers.value ?? ""}
              onChange={(event) => {
                const typed = parseNumber(event.currentTarget.value);
                workers.value = typed !== null && typed >= 1 ? Math.round(typed) : null;
              }}
            />
          </span>
        </label>
      )}
    </>
  );
}
