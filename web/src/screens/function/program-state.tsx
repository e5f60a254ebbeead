// What an import of an ASCET model calculates and what stops it: class, methods or tasks, ports, parameters, states.

import { MISSING, plain } from "../../drawing/numbers";
import { Icon } from "../../icons";
import type { ImportedFunction, ImportProblem } from "../../replies";
import { setKeys } from "../../settings";
import { open, screen, state } from "../../store";
import { Folders, limits, Ports, range } from "./import-lists";
import { showPlace } from "./program-text";
import { addSources, program } from "./source";

const ALL = "*"; // every periodic task
const FEW = 8; // problems that are listed at once

export function ProgramState() {
  const own = program.value;
  if (own === null) return <p class="pad q">Reading the model</p>;
  const few = own.missing?.length ? 0 : FEW;
  return (
    <div class="import">
      <Missing packages={own.missing ?? []} />
      {own.problems.slice(0, few).map((problem) => (
        <Problem problem={problem} />
      ))}
      {own.problems.length > few && (
        <details class="more">
          <summary>
            {own.problems.length - few}{" "}
            {few ? "more" : own.problems.length === 1 ? "problem" : "problems, most of them for this reason"}
          </summary>
          {own.problems.slice(few).map((problem) => (
            <Problem problem={problem} />
          ))}
        </details>
      )}
      {own.whole && (
        <p class="pad q">
          <Icon name="done" kind="good" /> Nothing stops it.
        </p>
      )}
      <Classes own={own} />
      <Methods own={own} />
      <Tasks own={own} />
      <Ports own={own} name="input" />
      <Characteristics own={own} />
      <States own={own} />
      <Folders
        title="Packages"
        sub="those beside the project are searched, too"
        word="packages"
        accept=".esdl,.app"
        add={(files) => void addSources(files)}
      />
      <Notes own={own} />
    </div>
  );
}

/** Packages without files, which most of the other problems come from. */
function Missing({ packages }: { packages: string[] }) {
  if (packages.length === 0) return null;
  return (
    <div class="note warn" data-missing>
      <Icon name="warning" />
      <span class="grow">
        <b>{packages.length === 1 ? "A package is missing" : `${packages.length} packages are missing`}: </b>
        {packages.join(", ")}. Drop their files or the folder of their project here, or name a folder below.
        <span class="row">
          <label class="btn small">
            Add files
            <input
              type="file"
              multiple
              accept=".esdl,.app"
              hidden
              onChange={(event) => void addSources([...(event.currentTarget.files ?? [])])}
            />
          </label>
        </span>
      </span>
    </div>
  );
}

function Problem({ problem }: { problem: ImportProblem }) {
  return (
    <div class="note bad" role="alert">
      <Icon name="warning" />
      <span class="grow">
        {problem.line > 0 && problem.source >= 0 ? (
          <button
            class="link plain"
            title="Show the line"
            onClick={() => showPlace(`${problem.source}:${problem.line}`)}
          >
            {problem.text}
          </button>
        ) : (
          problem.text
        )}
      </span>
    </div>
  );
}

function Classes({ own }: { own: ImportedFunction }) {
  if ((own.classes ?? []).length < 2) return null;
  const change = (name: string) =>
    setKeys(
      [
        [["model", "class"], name || null],
        [["model", "methods"], null],
        [["model", "startup"], null],
      ],
      name ? `The class is ${name}` : "No class is chosen",
    );
  return (
    <>
      <div class="head mid">
        <h2>Class</h2>
        <span class="sub">{own.classes!.length} in this file</span>
      </div>
      <div class="pad">
        <select
          class="field"
          aria-label="Class"
          title="[model] class"
          value={own.chosen.class}
          onChange={(event) => void change(event.currentTarget.value)}
        >
          <option value="">choose one</option>
          {own.classes!.map((each) => (
            <option value={each.name}>{each.name}</option>
          ))}
        </select>
      </div>
    </>
  );
}

/** Boxes that add names to a list of the project file, or remove them. */
function Boxes({
  names,
  chosen,
  change,
  titles,
  ordered = false,
}: {
  names: string[];
  chosen: string[];
  change: (names: string[]) => void;
  titles?: string[];
  ordered?: boolean;
}) {
  return (
    <div class="chips">
      {names.map((name, k) => (
        <label class="chip" title={titles?.[k]}>
          <input
            type="checkbox"
            checked={chosen.includes(name)}
            onChange={(event) =>
              change(event.currentTarget.checked ? [...chosen, name] : chosen.filter((each) => each !== name))
            }
          />
          {name}
          {ordered && chosen.length > 1 && chosen.includes(name) && <i>{chosen.indexOf(name) + 1}</i>}
        </label>
      ))}
    </div>
  );
}

function Methods({ own }: { own: ImportedFunction }) {
  const classes = own.classes ?? [];
  const item = classes.length === 1 ? classes[0] : classes.find((each) => each.name === own.chosen.class);
  if (item === undefined || item.methods.length < 2) return null;
  const called = (own.calls ?? []).map((label) => label.split(".").at(-1)!);
  const explicit = own.chosen.methods.length > 0;
  return (
    <>
      <div class="head mid">
        <h2>Methods of a step</h2>
        <span class="sub">{explicit ? "called in this order" : "as its task calls them"}</span>
        {explicit && (
          <span class="right">
            <button
              class="btn small"
              title="Call the methods of its task&#10;[model] methods"
              onClick={() => void setKeys([[["model", "methods"], null]], "The methods of the task are called")}
            >
              Default
            </button>
          </span>
        )}
      </div>
      <Boxes
        ordered
        names={item.methods}
        chosen={explicit ? own.chosen.methods : called}
        change={(names) =>
          void setKeys(
            [[["model", "methods"], names.length ? names : null]],
            names.length ? `A step calls ${names.join(", ")}` : "The methods of the task are called",
          )
        }
      />
      {(own.startup ?? []).length > 0 && (
        <p class="pad q">Once before: {own.startup!.map((label) => label.split(".").at(-1)).join(", ")}</p>
      )}
    </>
  );
}

const seconds = (period: number | null): string => (period === null ? "not periodic" : `every ${plain(period)} s`);

function Tasks({ own }: { own: ImportedFunction }) {
  const tasks = own.tasks ?? [];
  if (tasks.length === 0) return null;
  const periodic = tasks.filter((each) => each.period !== null).map((each) => each.name);
  const all = own.chosen.tasks.includes(ALL);
  const chosen = all ? periodic : own.chosen.tasks.length || tasks.length > 1 ? own.chosen.tasks : [tasks[0]!.name];
  const change = (names: string[]) => {
    const value =
      names.length === 0
        ? null
        : names.length === 1
          ? names[0]!
          : periodic.length > 1 && periodic.every((name) => names.includes(name)) && names.length === periodic.length
            ? ALL
            : names;
    void setKeys(
      [[["model", "task"], value]],
      value === null ? "No task is chosen" : value === ALL ? "All periodic tasks run" : `Tasks: ${names.join(", ")}`,
    );
  };
  return (
    <>
      <div class="head mid">
        <h2>Tasks</h2>
        <span class="sub">{own.step ? `step ${plain(own.step)} s` : "of the application"}</span>
        {periodic.length > 1 && (
          <span class="right">
            <button
              class="btn small"
              disabled={all}
              title="Run all periodic tasks, each at its own period&#10;[model] task"
              onClick={() => change(periodic)}
            >
              All
            </button>
          </span>
        )}
      </div>
      {tasks.length > 1 && (
        <Boxes
          names={tasks.map((each) => each.name)}
          chosen={chosen}
          change={(names) => change(tasks.map((each) => each.name).filter((name) => names.includes(name)))}
          titles={tasks.map((each) => `${seconds(each.period)}\n${each.methods.join("\n")}`)}
        />
      )}
      {chosen.length > 0 && (
        <table class="list">
          <thead>
            <tr>
              <th>task</th>
              <th>runs</th>
              <th>calls</th>
            </tr>
          </thead>
          <tbody>
            {tasks
              .filter((each) => chosen.includes(each.name))
              .map((each) => (
                <tr title={each.methods.join("\n")}>
                  <td>
                    <b>{each.name}</b>
                  </td>
                  <td class="q">{seconds(each.period)}</td>
                  <td class="mono cut">
                    {each.methods.map((label) => label.split(".").slice(-2).join(".")).join(", ")}
                  </td>
                </tr>
              ))}
          </tbody>
        </table>
      )}
      {(own.startup ?? []).length > 0 && (
        <p class="pad q">Once before: {own.startup!.map((label) => label.split(".").slice(-2).join(".")).join(", ")}</p>
      )}
    </>
  );
}

function Characteristics({ own }: { own: ImportedFunction }) {
  const rows = own.parameters ?? [];
  if (rows.length === 0) return null;
  const known = new Set(state.value.parameters.map((each) => each.name));
  const places = new Map((own.places ?? []).map((each) => [each.name, each]));
  return (
    <>
      <div class="head mid">
        <h2>Characteristics</h2>
        <span class="sub">
          {rows.length} {rows.length === 1 ? "parameter" : "parameters"}
        </span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>name</th>
            <th>kind</th>
            <th class="num">value</th>
            <th>declared in</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((each) => {
            const place = places.get(each.name);
            return (
              <tr key={each.name} title={limits(each)}>
                <td class="cut">
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
                <td class="cut">
                  {place && (
                    <button
                      class="link"
                      title="Show the line"
                      onClick={() => showPlace(`${place.source}:${place.line}`)}
                    >
                      {own.sources?.[place.source]?.file.split("/").at(-1)}:{place.line}
                    </button>
                  )}
                </td>
              </tr>
            );
          })}
        </tbody>
      </table>
    </>
  );
}

function States({ own }: { own: ImportedFunction }) {
  const rows = own.states ?? [];
  if (rows.length === 0) return null;
  return (
    <details class="more">
      <summary>
        {rows.length} {rows.length === 1 ? "variable keeps its value" : "variables keep their values"} from step to step
      </summary>
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
    </details>
  );
}

function Notes({ own }: { own: ImportedFunction }) {
  const notes = own.notes ?? [];
  const step = own.step ? `the step ${plain(own.step)} s` : "the step of the data";
  return (
    <>
      {own.whole && (
        <div class="note">
          <span class="q">?</span>
          <span>Runs with {step}.</span>
        </div>
      )}
      {notes.length > 0 && (
        <details class="more">
          <summary>
            {notes.length} {notes.length === 1 ? "remark" : "remarks"} on differences from ASCET
          </summary>
          <ul>
            {notes.map((note) => (
              <li>{note || MISSING}</li>
            ))}
          </ul>
        </details>
      )}
    </>
  );
}
