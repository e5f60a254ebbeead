// The options of the FMU, and the files that are written: all that are ticked together, or none.

import {
  busy,
  chosenCount,
  code,
  existing,
  flipFormat,
  flipLanguage,
  fmi,
  folder,
  formats,
  inputs,
  languages,
  method,
  platforms,
  rounds,
  signals,
  step,
  waitsFor,
  writeFiles,
  written,
} from "../../control-unit";
import { counted } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import { LineInput, NumberInput } from "../../inputs";
import type { ControlUnit } from "../../replies";
import { failure, state } from "../../store";
import { address, inProject } from "../../uploads";

export function FmuPane({ own }: { own: ControlUnit }) {
  return (
    <section class="pane fmu" aria-label="FMU">
      <div class="head">
        <h2>FMU</h2>
        <span class="sub">co-simulation and model exchange, with its sources</span>
      </div>
      <div class="keys">
        <span class="q">version</span>
        <Segment
          label="Version of FMI"
          options={["2.0", "3.0"]}
          chosen={`${fmi.value}.0`}
          choose={(option) => {
            fmi.value = option === "3.0" ? 3 : 2;
          }}
        />
        <span class="q">inputs</span>
        <Segment
          label="Inputs"
          options={["start of step", "end"]}
          chosen={inputs.value === "end" ? "end" : "start of step"}
          choose={(option) => {
            inputs.value = option === "end" ? "end" : "start";
          }}
        />
        <span class="q">step</span>
        <span class="row">
          <span class={`field small num ${step.value === null ? "empty" : ""}`} style={{ width: "104px" }}>
            <NumberInput
              label="Step of the FMU"
              placeholder="as the data"
              own={step.value ?? undefined}
              enter={(value, text) => {
                if (value === null || (typeof value === "number" && value > 0)) step.value = value;
                else failure.value = `The step of the FMU must be > 0, got '${text}'`;
              }}
            />
            <u>s</u>
          </span>
        </span>
      </div>
      <p class="pad q">
        {inputs.value === "end"
          ? "Inputs that are set before a step count at its end, to which the outputs behind it belong."
          : "Inputs that are set before a step count at its start, as tools do that hold them over the step."}
      </p>
      <div class="platforms" role="group" aria-label="Platforms" title={own.cross}>
        {own.platforms.map((each) => (
          <label class={own.cross === "" ? "" : "q"}>
            <input
              type="checkbox"
              disabled={own.cross !== ""}
              checked={platforms.value.includes(each)}
              onChange={(event) => {
                const others = platforms.value.filter((other) => other !== each);
                platforms.value = event.currentTarget.checked ? [...others, each] : others;
              }}
            />
            {each}
          </label>
        ))}
      </div>
      <p class="pad q" id="fmu-platform">
        {own.compiler === "" ? (
          <span class="warn">No C compiler found: the FMU has its sources only. </span>
        ) : (
          `Compiled by ${own.compiler} for this computer, ${own.platform}. `
        )}
        {own.cross === ""
          ? "Libraries for the ticked platforms are added; they cannot be run here. "
          : "Libraries for other platforms need the package ziglang. "}
        All others compile the sources in it.
      </p>
    </section>
  );
}

const VALUES = {
  "": "the values as they are",
  nearest: "the values, each rounded to the nearest",
  joint: "the values, rounded together",
};

const LANGUAGES = [
  ["c", "C code", (name: string) => `${name}.c, ${name}.h`],
  ["fmu", "FMU", (name: string) => `${name}.fmu`],
  ["m", "MATLAB function", (name: string) => `${name}.m`],
] as const;

export function FilesPane({ own }: { own: ControlUnit }) {
  const name = code.value?.name ?? "";
  return (
    <section class="pane files" aria-label="Files">
      <div class="head">
        <h2>Files</h2>
        <span class="sub">{VALUES[rounds.value ? method.value : ""]}</span>
        <span class="right">
          <button
            class="btn small primary"
            id="write-unit"
            disabled={
              chosenCount.value === 0 || waitsFor.value !== "" || busy.value !== "" || existing.value.length > 0
            }
            title="All files together, or none (w)"
            onClick={() => void writeFiles(false)}
          >
            {busy.value === "writing" ? "Writing" : waitsFor.value || `Write ${counted(chosenCount.value, "item")}`}
          </button>
        </span>
      </div>
      <div class="ticks">
        {LANGUAGES.map(([language, title, files]) => (
          <label data-language={language}>
            <input type="checkbox" checked={languages.value.has(language)} onChange={() => flipLanguage(language)} />
            <span class="ink">{title}</span>
            <span class="mono cut">{name ? files(name) : ""}</span>
          </label>
        ))}
        {own.formats.map((ending) => (
          <label data-format={ending.slice(1)}>
            <input type="checkbox" checked={formats.value.has(ending)} onChange={() => flipFormat(ending)} />
            <span class="ink">{ending.slice(1).toUpperCase()}</span>
            <span class="mono cut">parameters{ending}</span>
          </label>
        ))}
        <label
          data-format="mf4"
          title="All nodes, targets and errors over all recordings, a group for each, with units and comments"
        >
          <input
            type="checkbox"
            checked={signals.value}
            onChange={() => {
              signals.value = !signals.value;
              existing.value = [];
            }}
          />
          <span class="ink">Signals, MF4</span>
          <span class="mono cut">simulation.mf4</span>
        </label>
      </div>
      <div class="into">
        <span class="q">into</span>
        <span class="field small mono" style={{ width: "196px" }} title="A folder within that of the project">
          <LineInput
            label="Folder"
            placeholder={own.folder}
            text={folder.value}
            enter={(text) => {
              folder.value = text;
              existing.value = [];
            }}
          />
        </span>
      </div>
      {existing.value.length > 0 && (
        <div class="note warn" id="existing" role="alert">
          <Icon name="warning" />
          <span class="grow">
            {existing.value.join(", ")} {existing.value.length === 1 ? "exists" : "exist"} with another content. Nothing
            was written.
          </span>
          <button
            class="btn small"
            id="replace-unit"
            disabled={busy.value !== ""}
            onClick={() => void writeFiles(true)}
          >
            Replace {existing.value.length === 1 ? "it" : "them"}
          </button>
          <button
            class="btn small"
            onClick={() => {
              existing.value = [];
            }}
          >
            Keep
          </button>
        </div>
      )}
      {written.value !== null && <Written />}
    </section>
  );
}

function Written() {
  const { files, findings, compared } = written.value!;
  return (
    <div class="pad" id="written-unit">
      <p>
        <span class="good">Written:</span>{" "}
        {files.map((path, k) => (
          <>
            {k > 0 && ", "}
            <a href={address(path)} download title={path}>
              {path.split("/").at(-1)}
            </a>
          </>
        ))}
        {compared !== null && (
          <span class="q">
            {" "}
            · the C code compared over {counted(compared.samples, "sample")}
            {compared.exact ? ", equal bit for bit" : ""}
          </span>
        )}
      </p>
      {findings.map((text) => (
        <p class="note">{text}</p>
      ))}
      {state.value.unsaved.length === 0 ? (
        <a class="q" href={inProject("/project.zip")} download>
          The folder as ZIP
        </a>
      ) : null}
    </div>
  );
}
