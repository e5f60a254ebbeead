// A new project: from files that are dropped, an empty one, one by its path, or a demo.

import { signal } from "@preact/signals";
import { css, height } from "../../drawing/colours";
import { Icon } from "../../icons";
import { known, opening, openProject, projectFrom } from "../../projects";

const path = signal("");
const name = signal("");
const over = signal(false);

export function NewProject() {
  return (
    <section class="pane new">
      <div class="head">
        <h2>New project</h2>
        <span class="sub" title={known.value.folder}>
          a folder in {known.value.folder}
        </span>
      </div>
      <div class="pad">
        <label
          class={`drop-zone ${over.value ? "over-it" : ""}`}
          id="drop"
          onDragOver={(event) => {
            event.preventDefault();
            over.value = true;
          }}
          onDragLeave={() => {
            over.value = false;
          }}
          onDrop={() => {
            over.value = false;
          }}
        >
          <Icon name="file" kind="big" />
          <span>
            <b>Drop recordings, a model or values here</b>
            <br />
            <span class="q">
              MDF, CSV, Excel, MAT, Parquet; .kf, .slx, .mdl, .fmu, .onnx, .c, .py; .esdl, .app or a folder of ASCET;
              DCM, CDFX, A2L with HEX. Or click to choose files.
            </span>
          </span>
          {!opening.value && (
            <input
              type="file"
              multiple
              aria-label="Files of a new project"
              onChange={(event) => projectFrom([...(event.currentTarget.files ?? [])])}
            />
          )}
        </label>
        <form
          class="open-path"
          onSubmit={(event) => {
            event.preventDefault();
            openProject("new", { name: name.value }, "data");
          }}
        >
          <label class="field" style={{ flex: 1 }} title="Name or path of the folder of an empty project">
            <Icon name="plus" kind="q" />
            <input
              aria-label="Name of the new project"
              placeholder="name of an empty project"
              value={name.value}
              onInput={(event) => {
                name.value = event.currentTarget.value;
              }}
            />
          </label>
          <button class="btn" type="submit" disabled={!name.value.trim()}>
            Create
          </button>
        </form>
        <form
          class="open-path"
          onSubmit={(event) => {
            event.preventDefault();
            openProject("open", { path: path.value });
          }}
        >
          <label class="field" style={{ flex: 1 }} title="A kennfeld.toml, or the folder that holds one">
            <Icon name="folder" kind="q" />
            <input
              aria-label="Path of a project"
              placeholder="path of a kennfeld.toml"
              value={path.value}
              onInput={(event) => {
                path.value = event.currentTarget.value;
              }}
            />
          </label>
          <button class="btn" type="submit" disabled={!path.value.trim()}>
            Open
          </button>
        </form>
      </div>
      <div class="head mid">
        <h2>Demos</h2>
        <span class="sub">complete projects with data, copied to a folder of yours</span>
      </div>
      {known.value.demos.map((demo) => (
        <button
          class="demo"
          data-demo={demo.name}
          title={`Open the demo in kennfeld-demo-${demo.name}`}
          onClick={() => openProject("demo", { name: demo.name })}
        >
          <DemoPicture name={demo.name} />
          <span class="grow">
            <b>{demo.title}</b>
            <br />
            {demo.text}
            <br />
            <small class="q">{demo.facts}</small>
          </span>
          <span class="btn small">Open</span>
        </button>
      ))}
      <span style={{ flex: 1 }} />
      <p class="pad q about">
        <span>Kennfeld {known.value.version}</span>
        <span class="right">runs on this computer only, at {location.host}</span>
      </p>
    </section>
  );
}

/** A sketch of a demo: a map, or a speed that follows steps. */
function DemoPicture({ name }: { name: string }) {
  if (name === "idle")
    return (
      <svg class="demo-picture" viewBox="0 0 54 36" aria-hidden="true">
        <path d="M2 28h10l1-16h12l1 12h10l1-16h10l1 10h5" fill="none" stroke="var(--model)" stroke-width="1.5" />
      </svg>
    );
  const [columns, rows] = name === "torque" ? [13, 9] : [9, 6];
  const value = (i: number, j: number) =>
    name === "torque"
      ? 0.82 * (j / (rows - 1)) + 0.18 * Math.sin((Math.PI * i) / columns)
      : (i / (columns - 1) + j / (rows - 1)) / 2;
  return (
    <svg class="demo-picture" viewBox="0 0 54 36" aria-hidden="true">
      {Array.from({ length: columns * rows }, (_, k) => [Math.floor(k / rows), k % rows] as const).map(([i, j]) => (
        <rect
          x={(54 * i) / columns}
          y={36 - (36 * (j + 1)) / rows}
          width={54 / columns + 0.3}
          height={36 / rows + 0.3}
          fill={css(height(value(i, j)))}
        />
      ))}
    </svg>
  );
}
