// The frame around every screen: header with the errors and the job, the steps on the left, the status line.

import type { ComponentChildren } from "preact";
import { overlay, TITLES } from "./commands";
import { detail as written } from "./control-unit";
import { count, MISSING } from "./drawing/numbers";
import { Errors } from "./errors";
import { shortened } from "./header-lines";
import { Icon, Logo } from "./icons";
import { run } from "./runs";
import { save } from "./saving";
import { valueAt } from "./settings";
import {
  blocking,
  connected,
  failure,
  isRunning,
  message,
  move,
  request,
  type Screen,
  screen,
  state,
  toggleTheme,
} from "./store";

export function Header() {
  const { project, unsaved, undo, redo, job, waiting } = state.value;
  const running = isRunning(job);
  return (
    <header>
      <h1 class="unseen">{[TITLES[screen.value], project?.name, "Kennfeld"].filter(Boolean).join(", ")}</h1>
      <div class="bar0">
        <div class="brand">
          <Logo />
          <span class="word">Kennfeld</span>
          <span class="pj" aria-hidden="true">
            <b title={project?.name}>{shortened(project?.name ?? "No project", 18)}</b>
            <small class={unsaved.length ? "edits" : ""}>
              {unsaved.length ? `${unsaved.length} unsaved` : project ? "saved" : "drop a file"}
            </small>
          </span>
        </div>
        <div class="project">
          <b class="cut" title={project?.name}>
            {shortened(project?.name ?? "No project", 26)}
          </b>
          <small class={unsaved.length ? "dirty" : ""} id="unsaved">
            <span class="cut" title={unsaved.join("\n")}>
              {unsaved.length
                ? `${unsaved.length} unsaved change${unsaved.length > 1 ? "s" : ""}`
                : (project?.path ?? "")}
            </span>
          </small>
        </div>
        <Errors />
        <div class="set">
          <button
            class="btn bare icon"
            id="undo"
            title={undo ? `Undo: ${undo} (Ctrl+Z)` : "Undo (Ctrl+Z)"}
            aria-label="Undo"
            disabled={!undo && waiting.length === 0}
            onClick={() => move("undo")}
          >
            <Icon name="undo" />
          </button>
          <button
            class="btn bare icon"
            id="redo"
            title={redo ? `Redo: ${redo} (Ctrl+Y)` : "Redo (Ctrl+Y)"}
            aria-label="Redo"
            disabled={!redo}
            onClick={() => move("redo")}
          >
            <Icon name="redo" />
          </button>
        </div>
        <div class="set">
          <button
            class="btn"
            id="save"
            title="Save kennfeld.toml (Ctrl+S)"
            disabled={!unsaved.length}
            onClick={() => void save()}
          >
            Save
          </button>
          <button
            class="btn wide"
            id="export"
            title="Export values, report, script (Ctrl+E)"
            onClick={() => {
              screen.value = "results";
            }}
          >
            Export
          </button>
        </div>
        <div class="set end">
          <div class="job">
            <div id="job-state" class={running ? "running" : job.state}>
              {job.state}
            </div>
            {waiting.length > 0 ? (
              <span
                class="warn"
                id="edits-wait"
                title={`Applied to the values of the run at its end:\n${waiting.join("\n")}`}
              >
                {waiting.length === 1 ? "1 edit waits" : `${waiting.length} edits wait`}
              </span>
            ) : (
              <JobText />
            )}
          </div>
          <button
            class="btn primary"
            id="run"
            title={blocking.value ? `Cannot run: ${blocking.value.text}` : "Run (F5)"}
            disabled={running || !project || blocking.value !== null}
            onClick={run}
          >
            <Icon name="run" />
            <span class="text">Run</span>
          </button>
          <button
            class="btn stop"
            id="stop"
            title="Stop and keep the best (Shift+F5)"
            disabled={!running}
            onClick={() => request("stop")}
          >
            <Icon name="stop" />
            <span class="text">Stop</span>
          </button>
        </div>
        <div class="set" style={{ gap: 0, paddingRight: 0 }}>
          <button
            class="btn bare icon"
            title="Find or do (Ctrl+K)"
            aria-label="Find or do"
            onClick={() => {
              overlay.value = "palette";
            }}
          >
            <Icon name="find" />
          </button>
          <button
            class="btn bare icon"
            id="theme"
            title="Light or dark"
            aria-label="Light or dark"
            onClick={toggleTheme}
          >
            <Icon name="theme" />
          </button>
        </div>
      </div>
    </header>
  );
}

/** What runs or has run; a narrow header leaves the time to the tooltip. */
function JobText() {
  const { job, runs } = state.value;
  const seconds = `${job.seconds.toFixed(isRunning(job) || job.validates ? 1 : 2)} s`;
  if (isRunning(job) || job.validates)
    return <span>{`${job.validates && !isRunning(job) ? "cross-validation" : job.message} · ${seconds}`}</span>;
  if (runs.length === 0) return <span>no run yet</span>;
  return (
    <span title={seconds}>
      run {runs.length} · {job.iterations} it.<i class="long"> · {seconds}</i>
    </span>
  );
}

interface Step {
  screen: Screen;
  key: number | string;
  title: string;
  detail: () => string;
}

function dataDetail(): string {
  const known = state.value.datasets;
  const listed = valueAt(["dataset"]);
  const number = known.length || (Array.isArray(listed) ? listed.length : 0);
  return `${number} dataset${number === 1 ? "" : "s"}${known.length ? ` · ${count(known.reduce((sum, d) => sum + d.samples, 0))}` : ""}`;
}

const STEPS: Step[] = [
  { screen: "data", key: 1, title: "Data", detail: dataDetail },
  {
    screen: "function",
    key: 2,
    title: "Function",
    detail: () => (state.value.nodes.length === 1 ? "1 node" : `${state.value.nodes.length} nodes`),
  },
  {
    screen: "parameters",
    key: 3,
    title: "Parameters",
    detail: () => {
      const changed = state.value.parameters.filter((p) => p.changed).length;
      return `${state.value.parameters.length}${changed ? ` · ${changed} changed` : ""}`;
    },
  },
  {
    screen: "optimization",
    key: 4,
    title: "Optimization",
    detail: () =>
      state.value.runs.length ? `run ${state.value.runs.length} ${state.value.runs.at(-1)!.status}` : "no run yet",
  },
  {
    screen: "results",
    key: 5,
    title: "Results",
    detail: () =>
      state.value.runs.length ? `${state.value.runs.length} run${state.value.runs.length > 1 ? "s" : ""}` : MISSING,
  },
];

/** What a search beside the calibration does, or what the last one has found. */
const searchDetail = (search: "terms" | "design", verb: string) => (): string =>
  state.value[search].state === "running" ? verb : state.value[search].detail;

export function Rail() {
  return (
    <nav class="rail" aria-label="Steps">
      {STEPS.map((step) => (
        <StepButton step={step} />
      ))}
      <hr />
      <StepButton step={{ screen: "plots", key: 6, title: "Plots", detail: () => "" }} />
      <StepButton step={{ screen: "files", key: 7, title: "Files", detail: () => "compare, merge" }} />
      <hr />
      <StepButton
        step={{ screen: "missing", key: 8, title: "Missing terms", detail: searchDetail("terms", "looking") }}
      />
      <StepButton
        step={{ screen: "design", key: 9, title: "Measure next", detail: searchDetail("design", "computing") }}
      />
      <StepButton step={{ screen: "control-unit", key: "E", title: "Control unit", detail: () => written.value }} />
      <span style={{ flex: 1 }} />
      <hr />
      <button
        class="one"
        title="Keys (?)"
        onClick={() => {
          overlay.value = "keys";
        }}
      >
        <i>?</i>
        <b>Keys</b>
      </button>
      <button
        class="one"
        data-screen="start"
        aria-current={screen.value === "start" ? "page" : undefined}
        onClick={() => {
          screen.value = "start";
        }}
      >
        <i />
        <b>Projects</b>
      </button>
    </nav>
  );
}

function StepButton({ step }: { step: Step }) {
  const worst = state.value.findings.filter((f) => f.screen === step.screen && f.severity !== "remark");
  return (
    <button
      data-screen={step.screen}
      title={`${step.title} (Alt+${step.key})`}
      aria-current={screen.value === step.screen ? "page" : undefined}
      onClick={() => {
        screen.value = step.screen;
      }}
    >
      <i>{step.key}</i>
      <b>{step.title}</b>
      {worst.length ? <Icon name="warning" kind="w" /> : <span />}
      <small>{state.value.project === null ? "no project" : step.detail()}</small>
    </button>
  );
}

/** What share of the samples the screens show, if the data are in partitions. */
function Excerpt() {
  const { excerpt } = state.value;
  if (!excerpt) return null;
  const [shown, all] = excerpt;
  const share = `${((100 * shown) / all).toPrecision(2)} % of the samples`;
  return (
    <span
      id="excerpt"
      class="warn"
      title={`The data are in partitions. The screens show and evaluate ${count(shown)} of ${count(all)}. A run evaluates all of them; so do its table of errors, its uncertainties and the report.`}
    >
      Excerpt: {share}. Runs and reports use all.
    </span>
  );
}

export function Footer({ children }: { children?: ComponentChildren }) {
  const text = !connected.value
    ? "Kennfeld does not answer; waiting for it to come back."
    : failure.value || message.value;
  return (
    <footer>
      <span class={failure.value || !connected.value ? "bad" : "ink"} role="status" title={text}>
        {text}
      </span>
      <Excerpt />
      {state.value.seconds > 0 && (
        <span>recomputed in {(state.value.seconds * 1000).toFixed(state.value.seconds < 0.01 ? 1 : 0)} ms</span>
      )}
      <span class="keys">{children}</span>
    </footer>
  );
}

export function Key({ keys, text }: { keys: string[]; text: string }) {
  return (
    <span>
      {keys.map((key) => (
        <kbd>{key}</kbd>
      ))}{" "}
      {text}
    </span>
  );
}
