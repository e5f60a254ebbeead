// What a function in a file of another tool reads and returns: the choice of the function, problems, ports, parameters,
// states, remarks.

import { CodeConsent } from "../../code-consent";
import { plain } from "../../drawing/numbers";
import { Icon } from "../../icons";
import type { CalibratableParameter, ImportProblem, ProjectFunction } from "../../replies";
import { open, screen, state } from "../../store";
import { showLine } from "./code-text";
import { fileFunction } from "./file-source";
import { limits, Ports, range } from "./import-lists";
import { choose } from "./source";

const FEW = 8; // problems that are listed at once

export function FileState() {
  const own = fileFunction.value;
  if (own === null) return <p class="pad q">Reading the file</p>;
  return (
    <div class="import">
      <CodeConsent />
      {own.problems.slice(0, FEW).map((problem) => (
        <Problem problem={problem} />
      ))}
      {own.problems.length > FEW && (
        <details class="more">
          <summary>{own.problems.length - FEW} more</summary>
          {own.problems.slice(FEW).map((problem) => (
            <Problem problem={problem} />
          ))}
        </details>
      )}
      <Choice own={own} />
      {own.whole && state.value.code.length === 0 && (
        <p class="pad q">
          <Icon name="done" kind="good" /> Nothing stops it.
        </p>
      )}
      <Ports own={own} name="input" />
      <Parameters rows={own.parameters ?? []} />
      <States own={own} />
      <Notes own={own} />
    </div>
  );
}

function Problem({ problem }: { problem: ImportProblem }) {
  return (
    <div class="note bad" role="alert">
      <Icon name="warning" />
      <span class="grow">
        {problem.line > 0 ? (
          <button class="link plain" title="Show the line" onClick={() => showLine(problem.line)}>
            {problem.text}
          </button>
        ) : (
          problem.text
        )}
      </span>
    </div>
  );
}

/** The functions of a source file, one of which is the function of the project. */
function Choice({ own }: { own: ProjectFunction }) {
  if (own.choices.length > 0) return <Interface own={own} />;
  if (!own.named || own.functions.length === 0) return null;
  return (
    <>
      <div class="head mid">
        <h2>Function</h2>
        <span class="sub">
          {own.functions.length} in {own.file}
        </span>
      </div>
      <div class="pad">
        <select
          class="field"
          aria-label="Function of the file"
          title="[model] file"
          value={own.function}
          onChange={(event) => {
            if (event.currentTarget.value) choose(`${own.file}:${event.currentTarget.value}`);
          }}
        >
          {!own.functions.includes(own.function) && (
            <option value={own.function}>{own.function ? `${own.function} (not in the file)` : "choose one"}</option>
          )}
          {own.functions.map((name) => (
            <option value={name}>{name}</option>
          ))}
        </select>
      </div>
    </>
  );
}

/** The interfaces of an FMU, one of which is used. */
function Interface({ own }: { own: ProjectFunction }) {
  return (
    <>
      <div class="head mid">
        <h2>Interface</h2>
        <span class="sub">with the solver of Kennfeld, or of the FMU</span>
      </div>
      <div class="pad">
        <select
          class="field"
          aria-label="Interface of the FMU"
          title="[model] file"
          value={own.function}
          onChange={(event) =>
            choose(event.currentTarget.value ? `${own.file}:${event.currentTarget.value}` : own.file)
          }
        >
          <option value="">by default</option>
          {own.choices.map((name) => (
            <option value={name}>{name.replace("_", name.startsWith("co") ? "-" : " ")}</option>
          ))}
        </select>
      </div>
    </>
  );
}

function Parameters({ rows }: { rows: CalibratableParameter[] }) {
  if (rows.length === 0) return null;
  const known = new Set(state.value.parameters.map((each) => each.name));
  return (
    <>
      <div class="head mid">
        <h2>Parameters</h2>
        <span class="sub">{rows.length} of the file</span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>name</th>
            <th>kind</th>
            <th class="num">value</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((each) => (
            <tr key={each.name} title={[each.name, limits(each)].filter(Boolean).join("\n")}>
              <td class="cut long">
                {known.has(each.name) ? (
                  <button
                    class="link"
                    title={`Open ${each.name}`}
                    onClick={() => {
                      open(each.name);
                      screen.value = "parameters";
                    }}
                  >
                    {each.name}
                  </button>
                ) : (
                  <b>{each.name}</b>
                )}
              </td>
              <td class="q">
                {each.kind} {each.shape.join(" × ")}
                {each.locked && " locked"}
              </td>
              <td class="num ink">
                {range(each)} <span class="q">{each.unit}</span>
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </>
  );
}

function States({ own }: { own: ProjectFunction }) {
  const rows = own.states ?? [];
  if (rows.length === 0) return null;
  return (
    <>
      <div class="head mid">
        <h2>States</h2>
        <span class="sub">keep their values from step to step</span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>state</th>
            <th class="num">first value</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((each) => (
            <tr>
              <td class="cut">
                <b>{each.name}</b>
              </td>
              <td class="num">{each.initial === null ? "calculated" : plain(each.initial)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </>
  );
}

function Notes({ own }: { own: ProjectFunction }) {
  const notes = own.notes ?? [];
  const step = own.step ? `the step ${plain(own.step)} s` : "the step of the data";
  return (
    <>
      {own.whole && ((own.states ?? []).length > 0 || own.step) && (
        <div class="note">
          <span class="q">?</span>
          <span>
            Runs with {own.solver && `solver ${own.solver} and `}
            {step}.
          </span>
        </div>
      )}
      {notes.length > 0 && (
        <details class="more" open>
          <summary>
            {notes.length} {notes.length === 1 ? "remark" : "remarks"}
          </summary>
          <ul>
            {notes.map((note) => (
              <li>{note}</li>
            ))}
          </ul>
        </details>
      )}
    </>
  );
}
