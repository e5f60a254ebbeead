// The data-driven models of the project: how good they are, where they hold, and their training.

import { computed, effect } from "@preact/signals";
import { newest } from "../../connection";
import { count, numberText } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import type { SurrogateRow, ValidityRow } from "../../replies";
import { scoped } from "../../scope";
import { setKeys } from "../../settings";
import { request, screen, state } from "../../store";
import { Fold, isOpen } from "./fold";

const all = scoped<SurrogateRow[]>([]);
const uses = scoped<{ revision: number; rows: ValidityRow[] } | null>(null);
const beginning = scoped(false);

const textRevision = computed(() => state.value.textRevision);
const trainingState = computed(() => state.value.training.state);

const load = newest(async (_: number) => {
  const reply = await request("surrogates");
  if (reply !== null) all.value = reply.head.surrogates;
});
const loadUses = newest(async (revision: number) => {
  const reply = await request("validity");
  if (reply !== null) uses.value = { revision, rows: reply.head.rows };
});

effect(() => {
  void trainingState.value;
  if (screen.value === "function" && state.value.project !== null) load(textRevision.value);
});
effect(() => {
  // counting all samples takes a while, so an edit of values does not repeat it
  const revision = textRevision.value;
  if (
    screen.value === "function" &&
    isOpen("surrogates") &&
    all.value.some((each) => each.state === "trained" && each.name)
  )
    loadUses(revision);
});

export function Surrogates() {
  const trained = all.value.filter((each) => each.state === "trained").length;
  const outside = uses.value?.rows.some((row) => row.share > 0) ?? false;
  return (
    <Fold
      title="Data-driven models"
      sub={
        all.value.length
          ? `${trained} of ${all.value.length} trained${outside ? ", used outside of their data" : ""}`
          : "for a quantity without a formula"
      }
      name="surrogates"
    >
      {all.value.map((each) => (
        <Model key={each.name + each.file} own={each} />
      ))}
      {beginning.value ? (
        <NewSurrogate />
      ) : (
        <p class="pad">
          <button
            class="btn small"
            onClick={() => {
              beginning.value = true;
            }}
            title="Train a model of one channel on the recordings of the project; formula text calls it like a table"
          >
            <Icon name="plus" />
            New data-driven model
          </button>
        </p>
      )}
    </Fold>
  );
}

function Model({ own }: { own: SurrogateRow }) {
  const { training } = state.value;
  const ours = training.file === own.training && own.training !== "";
  const running = training.state === "running";
  return (
    <div class="surrogate" data-surrogate={own.name || own.file}>
      <div class="row">
        <b class="ink">{own.name || own.file}</b>
        <span class={`tag ${own.state === "trained" ? "g" : own.state === "unreadable" ? "b" : "w"}`}>{own.state}</span>
        {!own.name && (
          <button
            class="btn small"
            title="Let formula text call it&#10;[surrogates]"
            onClick={() => {
              const name = own.file.replace(/\.json$/, "");
              void setKeys([[["surrogates", name], own.file]], `${name} can be called`);
            }}
          >
            Use
          </button>
        )}
        <span class="right">
          {ours && running ? (
            <button class="btn small stop" onClick={() => request("stop-training")}>
              <Icon name="stop" />
              Stop
            </button>
          ) : own.training ? (
            <button
              class="btn small"
              disabled={running || own.trainingProblem !== ""}
              title={
                running ? `The training of ${training.file} is running` : `kennfeld surrogate train ${own.training}`
              }
              onClick={() => request("train-surrogate", { file: own.training })}
            >
              <Icon name="run" />
              {own.state === "trained" ? "Train again" : "Train"}
            </button>
          ) : (
            <span class="q" title={`No training file beside the project writes ${own.file}`}>
              no training file
            </span>
          )}
        </span>
      </div>
      {own.inputs && (
        <p class="mono cut" title={`${own.centres} centres${own.step ? `, steps of ${own.step} s` : ""}`}>
          {own.output}
          {own.unit ? `[${own.unit}]` : ""} = {own.name || own.file}({own.inputs.join(", ")})
        </p>
      )}
      {[own.problem, own.trainingProblem].filter(Boolean).map((text) => (
        <p class="bad" role="alert">
          {text}
        </p>
      ))}
      {ours && training.state !== "idle" && (
        <p class={training.state === "failed" ? "bad" : "q"} role="status">
          {running ? `Training, ${training.seconds.toFixed(0)} s. ` : ""}
          {training.lines.at(-1)}
        </p>
      )}
      {own.quality && own.quality.length > 0 && <QualityTable own={own} />}
      {own.stability && <p class="q">{own.stability}</p>}
      {own.deviation && <p class="q">{own.deviation}</p>}
      {own.name && <Range own={own} />}
    </div>
  );
}

function QualityTable({ own }: { own: SurrogateRow }) {
  return (
    <table class="list">
      <thead>
        <tr>
          <th>dataset</th>
          <th>mode</th>
          <th class="num">samples</th>
          <th class="num">RMSE</th>
          <th class="num">R²</th>
          <th class="num">max |error|</th>
        </tr>
      </thead>
      <tbody>
        {own.quality!.map((row) => (
          <tr key={row.dataset + row.mode}>
            <td class="cut">
              {row.dataset} <span class="q">{row.use === "test" ? "test" : ""}</span>
            </td>
            <td class="q">{row.mode}</td>
            <td class="num">{count(row.samples)}</td>
            <td class="num ink">{numberText(row.rmse)}</td>
            <td class="num">{numberText(row.r2)}</td>
            <td class="num">{numberText(row.max_abs)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

/** Where it is used outside of its training data. */
function Range({ own }: { own: SurrogateRow }) {
  const rows = (uses.value?.rows ?? []).filter((row) => row.name === own.name);
  if (rows.length === 0) return null;
  const outside = rows.filter((row) => row.share > 0);
  const old = uses.value!.revision !== state.value.textRevision || state.value.unsaved.length > 0;
  return (
    <>
      {own.bounded === false ? (
        <p class="q">It has no validity range.</p>
      ) : outside.length === 0 ? (
        <p>
          <Icon name="done" kind="good" /> Used within its training data.
        </p>
      ) : (
        outside.map((row) => (
          <div class="note warn" data-outside={row.dataset}>
            <Icon name="warning" />
            <span class="grow">{row.text}.</span>
          </div>
        ))
      )}
      {old && (
        <p>
          <button class="link" onClick={() => loadUses(state.value.textRevision)}>
            Check at the present values
          </button>
        </p>
      )}
    </>
  );
}

/** Name, output and inputs of a new surrogate. */
function NewSurrogate() {
  const channels = [...new Set(state.value.datasets.flatMap((data) => data.channels.map((each) => each.name)))];
  return (
    <form
      class="pad new-surrogate"
      onSubmit={(event) => {
        event.preventDefault();
        void create();
      }}
    >
      <label>
        <span class="q">name</span>
        <span class="field small mono">
          <input
            aria-label="Name of the model"
            placeholder="engine"
            title="The name by which formula text calls it"
            value={draft.value.name}
            onInput={(event) => {
              draft.value = { ...draft.value, name: event.currentTarget.value.trim() };
            }}
          />
        </span>
      </label>
      <label>
        <span class="q">output</span>
        <select
          class="field small"
          aria-label="Output"
          value={draft.value.output}
          onChange={(event) => {
            const output = event.currentTarget.value;
            draft.value = { ...draft.value, output, inputs: draft.value.inputs.filter((name) => name !== output) };
          }}
        >
          <option value="">channel</option>
          {channels.map((name) => (
            <option value={name}>{name}</option>
          ))}
        </select>
      </label>
      <label>
        <span class="q">kind</span>
        <Segment
          label="Kind"
          options={["static", "dynamic"]}
          chosen={draft.value.kind}
          choose={(kind) => {
            draft.value = { ...draft.value, kind };
          }}
        />
      </label>
      <span class="q">inputs</span>
      <span class="row">
        {channels
          .filter((name) => name !== draft.value.output)
          .map((name) => (
            <button
              type="button"
              class="chip"
              aria-pressed={draft.value.inputs.includes(name)}
              onClick={() => toggle(name)}
            >
              {name}
            </button>
          ))}
      </span>
      <span class="row">
        <button
          class="btn small primary"
          type="submit"
          disabled={!draft.value.name || !draft.value.output || draft.value.inputs.length === 0}
        >
          Create
        </button>
        <button
          class="btn small"
          type="button"
          onClick={() => {
            beginning.value = false;
          }}
        >
          Cancel
        </button>
      </span>
    </form>
  );
}

const draft = scoped({ name: "", output: "", kind: "static", inputs: [] as string[] });

function toggle(name: string): void {
  const { inputs } = draft.value;
  draft.value = {
    ...draft.value,
    inputs: inputs.includes(name) ? inputs.filter((each) => each !== name) : [...inputs, name],
  };
}

/** Write the training file, and begin the training. */
async function create(): Promise<void> {
  const reply = await request("new-surrogate", draft.value);
  if (reply === null) return;
  beginning.value = false;
  draft.value = { name: "", output: "", kind: "static", inputs: [] };
  await request("train-surrogate", { file: reply.head.file });
}
