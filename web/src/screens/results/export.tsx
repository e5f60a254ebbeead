// Export of the present values: calibration files, report, simulation, script, all files of a run, and the folder.

import { effect } from "@preact/signals";
import { flipped } from "../../flipped";
import { RoundedTable } from "../../instruments/rounded";
import type { ExportedFiles, ExportFormats } from "../../replies";
import { scoped } from "../../scope";
import { request, screen, settled, state } from "../../store";
import { address, inProject } from "../../uploads";
import { Further } from "../optimization/settings";

const formats = scoped<ExportFormats>({ formats: [], own: [], folder: "", stored: false, opens: false });
const picked = scoped<Set<string> | null>(null);
const extras = scoped({ report: true, stored: false, script: false, whole: false });
const simulation = scoped("");
const existing = scoped(""); // name of the script that would be replaced
const exported = scoped<ExportedFiles>({ files: [], findings: [], rounded: [] });

effect(() => {
  // what was exported may be the results of a run
  void [settled.value.textRevision, exported.value];
  if (screen.value === "results" && settled.value.project !== null)
    void request("formats").then((reply) => {
      if (reply !== null) formats.value = reply.head;
    });
});

const EXTRAS = [
  ["report", "report.html", "The report on the last run, or on the present values if there was none: one HTML file"],
  [
    "stored",
    "report on the results folder",
    "The report on the run whose files are in the results folder, as kennfeld report writes it",
  ],
  ["script", "Python script that repeats the run", "calibrate.py beside the project file"],
  [
    "whole",
    "all files of a run",
    "What kennfeld calibrate writes: values, trace.csv, trust.csv, simulation.parquet and result.json, for the present values",
  ],
] as const;
const SIMULATIONS = ["parquet", "csv", "mf4", "mat"] as const;

export function ExportPane() {
  const { formats: all, own, folder } = formats.value;
  const chosen = picked.value ?? new Set(own);
  const flip = (ending: string) => {
    picked.value = flipped(chosen, ending);
  };
  const run = async (force: boolean) => {
    const reply = await request("export", {
      formats: [...chosen],
      ...extras.value,
      simulation: simulation.value,
      force,
    });
    existing.value = reply !== null && "exists" in reply.head ? reply.head.exists : "";
    if (reply !== null && !("exists" in reply.head)) exported.value = reply.head;
  };
  const total = chosen.size + Object.values(extras.value).filter(Boolean).length + Number(Boolean(simulation.value));
  return (
    <div id="export-pane">
      <div class="head mid">
        <h2>Export</h2>
        <span class="sub">present values</span>
      </div>
      <div class="pad">
        <div class="chips">
          {all.map((ending) => (
            <button
              class="chip"
              data-format={ending.slice(1)}
              aria-pressed={chosen.has(ending)}
              title={`parameters${ending}`}
              onClick={() => flip(ending)}
            >
              {ending.slice(1).toUpperCase()}
            </button>
          ))}
        </div>
        <div class="opt2">
          {EXTRAS.map(([key, text, help]) => (
            <label title={help}>
              <input
                type="checkbox"
                checked={extras.value[key]}
                disabled={(key === "whole" && !state.value.runs.length) || (key === "stored" && !formats.value.stored)}
                onChange={(event) => {
                  extras.value = {
                    ...extras.value,
                    ...(event.currentTarget.checked && key === "report"
                      ? { stored: false }
                      : event.currentTarget.checked && key === "stored"
                        ? { report: false }
                        : {}),
                    [key]: event.currentTarget.checked,
                  };
                }}
              />{" "}
              {text}
            </label>
          ))}
          <label title="All nodes and targets over all datasets at the present values, as kennfeld simulate writes them; mf4 (MDA, CANape) and mat hold each recording with its time stamps, errors and inputs">
            simulation{" "}
            <select
              class="field small"
              aria-label="Simulation"
              value={simulation.value}
              onChange={(event) => {
                simulation.value = event.currentTarget.value;
              }}
            >
              <option value="">no</option>
              {SIMULATIONS.map((ending) => (
                <option value={`.${ending}`}>simulation.{ending}</option>
              ))}
            </select>
          </label>
        </div>
        <Further section="report" skip={[]} label="title, author and comment of the report" />
        <p class="q cut" title={folder}>
          into {folder.split(/[\\/]/).slice(-2).join("/")}
        </p>
        <div class="go">
          <button class="btn primary" id="export-files" disabled={!total} onClick={() => run(false)}>
            {total === 1 ? "Export 1 file" : "Export"}
          </button>
          {existing.value && (
            <button class="btn" id="replace-script" onClick={() => run(true)}>
              Replace it
            </button>
          )}
          <a
            class="btn"
            id="export-folder"
            href={inProject("/project.zip")}
            download
            title="The folder of the project as it is on disk; unsaved changes are not in it"
          >
            Folder as ZIP
          </a>
        </div>
        {existing.value && <p class="note warn">{existing.value} exists already, with another content.</p>}
        {state.value.unsaved.length > 0 && <p class="q">The ZIP holds what is saved.</p>}
        {exported.value.files.length > 0 && (
          <div class="done" id="exported">
            <p class="row">
              <span class="good">Written</span>
              <span class="q cut grow" title={folder}>
                {folder}
              </span>
              {formats.value.opens && (
                <button class="btn small" id="open-folder" onClick={() => request("open-file", {})}>
                  Open the folder
                </button>
              )}
            </p>
            {exported.value.files.map((path) => (
              <Written key={path} path={path} opens={formats.value.opens} />
            ))}
          </div>
        )}
        {exported.value.findings.map((text) => (
          <p class="note warn">{text}</p>
        ))}
      </div>
      <RoundedTable rows={exported.value.rounded} />
    </div>
  );
}

/** A file that was written: opened on the desktop if there is one, else only downloaded. */
function Written({ path, opens }: { path: string; opens: boolean }) {
  const name = path.split("/").at(-1)!;
  return (
    <p class="row">
      <a class="cut grow" href={address(path)} download title={`Download ${path}`}>
        {name}
      </a>
      {opens && !name.endsWith(".py") && (
        <button
          class="btn small"
          aria-label={`Open ${name}`}
          title="With the program that your desktop has for it"
          onClick={() => request("open-file", { file: path })}
        >
          Open
        </button>
      )}
    </p>
  );
}
