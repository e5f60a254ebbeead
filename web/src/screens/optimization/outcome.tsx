// The lower pane of the optimization: tables, what the last run says, the steps of a sequence, and cross-validation.

import { parseNumber, significant } from "../../drawing/numbers";
import { Segment } from "../../fields";
import type { RunResult, StepRow } from "../../replies";
import { outcome, running, validate, view } from "../../runs";
import { scoped } from "../../scope";
import { blocking, state } from "../../store";

const typed = scoped<number | null>(null); // number of folds; null is the usual one
const parts = scoped("auto");

export function OutcomeHead({ sub, steps }: { sub: string; steps: StepRow[] }) {
  const options = ["tables", "result", ...(steps.length ? ["steps"] : []), "cross-validation"];
  const title =
    view.value === "tables"
      ? "Tables"
      : view.value === "result"
        ? "Result"
        : view.value === "steps"
          ? "Steps"
          : "Cross-validation";
  return (
    <div class="head">
      <h2>{title}</h2>
      <span class="sub cut">{view.value === "tables" ? sub : ""}</span>
      <span class="right">
        <Segment
          label="What is shown"
          options={options}
          chosen={view.value}
          choose={(option) => {
            view.value = option;
          }}
        />
      </span>
    </div>
  );
}

export function OutcomeBody({ steps }: { steps: StepRow[] }) {
  if (view.value === "steps" && steps.length) return <Steps rows={steps} />;
  if (view.value === "cross-validation") return <Validation />;
  const own = outcome.value.result;
  return own === null ? (
    <p class="pad q">
      After a run: errors by criterion and dataset, chosen smoothness and shifts, and what the search remarks.
    </p>
  ) : (
    <ResultTables own={own} />
  );
}

/** A table of text with a heading; columns of numbers are aligned right. */
export function Cells({ rows, id }: { rows: string[][]; id: string }) {
  const [head = [], ...body] = rows;
  const text = (column: number): boolean =>
    body.some((row) => Number.isNaN(Number(row[column])) && row[column] !== "-");
  return (
    <table class="list pt" id={id}>
      <thead>
        <tr>
          {head.map((cell, k) => (
            <th class={text(k) ? "" : "num"}>{cell}</th>
          ))}
        </tr>
      </thead>
      <tbody>
        {body.map((row) => (
          <tr>
            {row.map((cell, k) => (
              <td class={text(k) ? "" : "num ink"}>{cell}</td>
            ))}
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function ResultTables({ own }: { own: RunResult }) {
  const { seconds } = own;
  return (
    <div class="items" id="result">
      <Cells rows={own.quality} id="quality" />
      {own.warnings.map((text) => (
        <p class="note warn">{text}</p>
      ))}
      <dl class="facts pad wide">
        <dt>status</dt>
        <dd class="wrap">
          {own.status}: {own.message}
        </dd>
        <dt>effort</dt>
        <dd>
          {own.free} values free, {own.fixed} fixed; {own.iterations} iterations, {own.evaluations} evaluations;{" "}
          {significant(seconds.total ?? 0, 3)} s ({significant(seconds.compile ?? 0, 2)} s compiling)
        </dd>
        {own.smoothness.map((each) => (
          <>
            <dt>smoothness of {each.parameter}</dt>
            <dd data-smoothness={each.parameter}>
              {Object.entries(each.factors)
                .map(([axis, factor]) => `${axis} ${significant(factor, 3)}`)
                .join(", ")}
              , from the data
            </dd>
          </>
        ))}
        {own.shifts.map((each) => (
          <>
            <dt>shift of {each.channel}</dt>
            <dd>
              {significant(each.shift, 3)} in {each.dataset}
            </dd>
          </>
        ))}
        {own.breakpoints.map((each) => (
          <>
            <dt>breakpoints of {each.axis}</dt>
            <dd title={`before: ${each.before.map((v) => significant(v)).join(", ")}`}>
              {each.after.map((value) => significant(value, 4)).join(", ")}
            </dd>
          </>
        ))}
        {own.distances.length > 1 && (
          <>
            <dt>distance of starts</dt>
            <dd title="Distance of the end of each start from the best one, relative to the size of each parameter">
              {own.distances
                .map(([start, distance]) => `${start}: ${distance === null ? "unknown" : significant(distance, 2)}`)
                .join(", ")}
            </dd>
          </>
        )}
        {own.resumed.length > 0 && (
          <>
            <dt>resumed from</dt>
            <dd>{own.resumed.join(", ")}</dd>
          </>
        )}
        {own.extrapolations.map((text) => (
          <>
            <dt class="warn">surrogate</dt>
            <dd class="wrap">{text}</dd>
          </>
        ))}
      </dl>
    </div>
  );
}

function Steps({ rows }: { rows: StepRow[] }) {
  return (
    <div class="items">
      <table class="list" id="steps">
        <thead>
          <tr>
            <th class="num">step</th>
            <th>name</th>
            <th>state</th>
            <th class="num">iterations</th>
            <th class="num">cost</th>
            <th class="num">RMSE</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((row, k) => (
            <tr class={row.state === "running" ? "on" : ""} data-step={row.name}>
              <td class="num">{k + 1}</td>
              <td>
                <b>{row.name}</b>
              </td>
              <td>
                <span class={`tag ${row.state === "running" ? "t" : row.state === "done" ? "g" : ""}`}>
                  {row.state}
                </span>
              </td>
              <td class="num">{row.iterations || ""}</td>
              <td class="num">{row.cost === null ? "" : significant(row.cost, 5)}</td>
              <td class="num ink">{row.rmse === null ? "" : significant(row.rmse, 5)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

const PARTS = ["auto", "files", "blocks", "random"];

function Validation() {
  const own = outcome.value.validation;
  // each file is a fold, unless the user wants others
  const files = Math.max(2, outcome.value.files);
  const folds = typed.value ?? (parts.value === "files" ? files : 5);
  return (
    <div class="items">
      <div class="pl">
        <label title="Number of parts of the training data; each is held out once (kennfeld calibrate --cross-validate). Typical: 5">
          <span class="q">Folds</span>{" "}
          <span class="field small num" style={{ width: "44px" }}>
            <input
              aria-label="Folds"
              value={folds}
              onChange={(event) => {
                const number = parseNumber(event.currentTarget.value);
                if (number !== null && number >= 2) typed.value = Math.round(number);
              }}
            />
          </span>
        </label>
        <label title="files: whole files; blocks: contiguous parts of each file; random: single points; auto: files if there are enough, blocks for data in time, else random (--parts)">
          <span class="q">Parts</span>{" "}
          <select
            class="field small"
            aria-label="Parts"
            value={parts.value}
            onChange={(event) => {
              parts.value = event.currentTarget.value;
            }}
          >
            {PARTS.map((each) => (
              <option value={each}>{each}</option>
            ))}
          </select>
        </label>
        <button
          class="btn small"
          id="cross-validate"
          disabled={running() || state.value.project === null || blocking.value !== null}
          onClick={() => validate(folds, parts.value)}
        >
          Cross-validate
        </button>
        {own === null && (
          <span class="q cut">Calibrates once for each part without it, and scores the part. The values stay.</span>
        )}
      </div>
      {own && (
        <div id="validation">
          <Cells rows={own.table} id="folds" />
          {own.summary.map((text) => (
            <p class="pad ink">{text}</p>
          ))}
        </div>
      )}
    </div>
  );
}
