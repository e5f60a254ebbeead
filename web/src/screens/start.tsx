// The start: recent projects with their errors and state, a new project from dropped files, and the demos.

import { count, counted, significant, withUnit } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import {
  chosen,
  filter,
  known,
  loadProjects,
  openProject,
  projectFrom,
  selected,
  shownProjects,
  spoken,
} from "../projects";
import type { RecentRow } from "../replies";
import { request, type Screen, screen, state } from "../store";
import { droppedFiles } from "../uploads";
import { NewProject } from "./start/new-project";
import { Preview } from "./start/preview";

export function Start() {
  return (
    <>
      <main
        class="start"
        onDragOver={(event) => event.preventDefault()}
        onDrop={(event) => {
          event.preventDefault();
          void droppedFiles(event).then(projectFrom);
        }}
      >
        <RecentProjects />
        <PreviewPane />
        <Steps />
        <NewProject />
      </main>
      <Footer>
        <Key keys={["↑", "↓"]} text="choose" />
        <Key keys={["Enter"]} text="open" />
        <Key keys={["Ctrl", "K"]} text="find or do" />
        <Key keys={["?"]} text="keys" />
      </Footer>
    </>
  );
}

const openRecent = (each: RecentRow): void => {
  if (each.id === state.value.project?.id) screen.value = "parameters";
  else openProject("open", { path: each.path });
};

function RecentProjects() {
  const rows = shownProjects.value;
  const move = (event: KeyboardEvent) => {
    const at =
      rows.findIndex((each) => each.path === selected.value?.path) +
      (event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0);
    if (event.key === "Enter" && selected.value) openRecent(selected.value);
    else if (event.key.startsWith("Arrow") && rows[at]) chosen.value = rows[at]!.path;
    else return;
    event.preventDefault();
  };
  return (
    <section class="pane rec">
      <div class="head">
        <h2>Recent projects</h2>
        <span class="right">
          <label class="field small" style={{ width: "180px" }}>
            <Icon name="find" kind="q" />
            <input
              placeholder="Name, path, node"
              aria-label="Search projects"
              value={filter.value}
              onInput={(event) => {
                filter.value = event.currentTarget.value;
              }}
            />
          </label>
        </span>
      </div>
      {rows
        .filter((each) => each.unsaved && !each.open)
        .slice(0, 1)
        .map((each) => (
          <div class="note warn bar0">
            <Icon name="warning" />
            <span class="grow">{each.name} was not saved when Kennfeld ended. Its edits were kept.</span>
            <button class="btn small" onClick={() => openRecent(each)}>
              Open
            </button>
          </div>
        ))}
      {known.value.recent.length === 0 ? (
        <p class="pad q">Projects that you open are listed here. Open a demo, or drop a recording on the right.</p>
      ) : (
        <div class="items" role="region" tabIndex={0} aria-label="Recent projects" onKeyDown={move}>
          <table class="list tall" id="recent">
            <thead>
              <tr>
                <th>project</th>
                <th class="num">RMSE training</th>
                <th class="num">RMSE test</th>
                <th>
                  <span class="unseen">unit</span>
                </th>
                <th>error</th>
                <th>state</th>
                <th class="num">opened</th>
                <th>
                  <span class="unseen">forget</span>
                </th>
              </tr>
            </thead>
            <tbody>
              {rows.map((each) => (
                <ProjectRow own={each} />
              ))}
            </tbody>
          </table>
        </div>
      )}
    </section>
  );
}

function ProjectRow({ own }: { own: RecentRow }) {
  const rmse = (value: number | undefined) => (value === undefined ? "–" : significant(value));
  const shown = own.open && state.value.unsaved.length ? "unsaved" : own.unsaved ? "unsaved" : (own.state ?? "");
  return (
    <tr
      class={own.path === selected.value?.path ? "on" : ""}
      data-project={own.path}
      onClick={() => {
        chosen.value = own.path;
      }}
      onDblClick={() => openRecent(own)}
    >
      <td title={own.path}>
        <b>{own.name}</b>
        {own.open && <span class="tag t">open</span>}
        <br />
        <span class="q">{[own.folder, own.node].filter(Boolean).join(" · ")}</span>
      </td>
      <td class="num ink">{rmse(own.training)}</td>
      <td class="num ink">
        {own.training !== undefined && own.test === undefined ? <span class="q">no test</span> : rmse(own.test)}
      </td>
      <td class="q">{own.unit ?? ""}</td>
      <td>{own.histogram && <Histogram counts={own.histogram} />}</td>
      <td>
        {shown && (
          <span class={`tag ${shown === "converged" ? "g" : shown === "ready" ? "" : "w"}`} title={own.problem}>
            {shown}
          </span>
        )}
      </td>
      <td class="num q">{spoken(own.opened)}</td>
      <td>
        <button
          class="btn bare small"
          title="Take it out of this list; its files stay"
          aria-label={`Forget ${own.name}`}
          disabled={own.open}
          onClick={async (event) => {
            event.stopPropagation();
            await request("forget", { path: own.path });
            await loadProjects();
          }}
        >
          ×
        </button>
      </td>
    </tr>
  );
}

function Histogram({ counts }: { counts: number[] }) {
  const most = Math.max(1, ...counts);
  const width = 72 / counts.length;
  return (
    <svg class="histogram" width="72" height="20" viewBox="0 0 72 20" role="img" aria-label="Histogram of the errors">
      {counts.map((each, k) => (
        <rect x={k * width} y={19 - (18 * each) / most} width={width - 0.5} height={(18 * each) / most} />
      ))}
      <line x1="0" x2="72" y1="19.5" y2="19.5" />
      <line class="zero" x1="36" x2="36" y1="0" y2="20" />
    </svg>
  );
}

function PreviewPane() {
  const own = selected.value;
  if (own === undefined) return <section class="pane pre" />;
  const sets = (use: string) =>
    (own.datasets ?? [])
      .filter((each) => each[1] === use)
      .map(([name, , samples]) => `${name}, ${count(samples)}`)
      .join("; ");
  const facts: [string, string, string][] = [
    ["function", own.file ? `${own.file}, ${own.nodes ?? 0} nodes` : own.nodes ? `${own.nodes} nodes` : "", ""],
    ["training", sets("training"), ""],
    ["test", sets("test"), ""],
    ["parameters", own.parameters ? `${own.parameters}, with ${own.values} values` : "", ""],
    ["last run", own.run ? `${own.run}, ${own.state}` : "", ""],
    ["open", own.withoutData ? `${counted(own.withoutData, "value")} without data` : "", "warn"],
    ["problem", own.problem ?? "", "bad"],
  ];
  return (
    <section class="pane pre">
      <div class="head">
        <h2>{own.name}</h2>
        <span class="sub">{own.picture?.dataset ?? ""}</span>
        <span class="right">
          {own.picture && (
            <>
              <span class="key">
                <i style={{ color: "var(--ink)" }} />
                measured
              </span>
              <span class="key">
                <i style={{ color: "var(--model)" }} />
                now
              </span>
              {own.picture.timed && (
                <span class="key">
                  <i style={{ color: "var(--before)" }} />
                  start
                </span>
              )}
            </>
          )}
          <button class="btn small" id="open-recent" onClick={() => openRecent(own)}>
            Open
          </button>
        </span>
      </div>
      <div class="preview">
        <dl class="facts pad">
          {facts
            .filter(([, text]) => text)
            .map(([name, text, kind]) => (
              <>
                <dt>{name}</dt>
                <dd class={kind} title={text}>
                  {text}
                </dd>
              </>
            ))}
        </dl>
        {own.picture ? (
          <Preview own={own.picture} title={withUnit(own.node ?? "", own.unit ?? "")} />
        ) : (
          <p class="pad q">Its errors and a picture appear here once it was open.</p>
        )}
      </div>
    </section>
  );
}

const STEPS: [Screen, string, string][] = [
  ["data", "Data", "map the channels of your recordings"],
  ["function", "Function", "type a formula or open a model"],
  ["parameters", "Parameters", "axes, bounds, smoothness"],
  ["optimization", "Optimization", "check, run, watch"],
  ["results", "Results", "compare, accept, export"],
];

function Steps() {
  return (
    <section class="pane steps">
      {STEPS.map(([name, title, text], k) => (
        <button
          disabled={state.value.project === null}
          onClick={() => {
            screen.value = name;
          }}
        >
          <i>{k + 1}</i>
          <b>{title}</b>
          <span class="q">{text}</span>
        </button>
      ))}
    </section>
  );
}
