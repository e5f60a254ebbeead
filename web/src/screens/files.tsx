// Calibration files: compare two sets of values, take labels from one into the other, and write them in any format.

import {
  addFiles,
  chosen,
  comparison,
  descriptions,
  folder,
  pair,
  search,
  shown,
  sides,
  ticked,
  tolerance,
} from "../calibrations";
import { MISSING, parseNumber, plain, significant, unitText } from "../drawing/numbers";
import { Segment } from "../fields";
import { flipped } from "../flipped";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { Column, Pictures } from "../instruments/pictures";
import type { LabelDifference, LabelValues } from "../replies";
import { state } from "../store";
import { Actions } from "./files/actions";
import { ContentTable } from "./files/contents";

export function Files() {
  return (
    <>
      <main
        class="files-view"
        onDragOver={(event) => event.preventDefault()}
        onDrop={(event) => {
          event.preventDefault();
          void addFiles([...(event.dataTransfer?.files ?? [])]);
        }}
      >
        <Bar />
        <FileList />
        {shown.value === "contents" ? <ContentTable /> : <Differences />}
        {shown.value === "differences" && <PairPane />}
        <Actions />
      </main>
      <Footer>
        <Key keys={["↑", "↓"]} text="choose" />
        <Key keys={["Space"]} text="tick" />
        <span>drop calibration files anywhere</span>
      </Footer>
    </>
  );
}

function Bar() {
  const result = comparison.value;
  return (
    <section class="pane bar">
      <div class="head">
        <h2>Compare</h2>
        <SourceChoice label="First set" side="first" />
        <span class="q">with</span>
        <SourceChoice label="Second set" side="second" />
        <button
          class="btn small"
          title="Swap the two sets"
          aria-label="Swap"
          onClick={() => {
            [sides.first.value, sides.second.value] = [sides.second.value, sides.first.value];
          }}
        >
          ⇄
        </button>
        <span class="sep" />
        <ToleranceField
          label="Absolute tolerance"
          which="absolute"
          help="Values that differ by less count as equal, in the unit of the values (kennfeld diff --tolerance). Typical: 0"
        />
        <ToleranceField
          label="Relative tolerance"
          which="relative"
          help="Values that differ by less than this share count as equal (kennfeld diff --relative). Typical: 1e-6"
        />
        <span class="right q" id="difference-count">
          {result === null
            ? ""
            : result.count === 0
              ? `equal: ${result.compared} names in both`
              : `${result.count} of ${result.compared} names differ`}
        </span>
        <Segment
          label="What is shown"
          options={["differences", "contents"]}
          chosen={shown.value}
          choose={(option) => {
            if (option === "differences" && sides.second.value.toLowerCase().endsWith(".a2l"))
              sides.second.value = "start";
            shown.value = option as typeof shown.value;
          }}
        />
      </div>
    </section>
  );
}

function SourceChoice({ label, side }: { label: string; side: "first" | "second" }) {
  const value = sides[side].value;
  const image = folder.value.files.find((file) => `file:${file.name}` === value)?.image ?? false;
  const name = value.slice(5);
  return (
    <>
      <select
        class="field small"
        aria-label={label}
        id={`${side}-set`}
        value={value}
        onChange={(event) => {
          sides[side].value = event.currentTarget.value;
        }}
      >
        <option value="now">present values</option>
        <option value="start">start</option>
        {state.value.runs.map((run) => (
          <option value={String(run.number)}>run {run.number}</option>
        ))}
        {folder.value.files.map((file) => (
          <option value={`file:${file.name}`}>{file.name}</option>
        ))}
        {shown.value === "contents" &&
          side === "second" &&
          folder.value.descriptions.map((name) => <option value={`file:${name}`}>{name}</option>)}
      </select>
      {image && (
        <select
          class="field small"
          aria-label={`A2L file of ${name}`}
          title="The A2L file that describes the image; without a choice the one of the same name, or the only one in its folder"
          value={descriptions.value[name] ?? ""}
          onChange={(event) => {
            descriptions.value = { ...descriptions.value, [name]: event.currentTarget.value };
          }}
        >
          <option value="">its A2L</option>
          {folder.value.descriptions.map((each) => (
            <option value={each}>{each}</option>
          ))}
        </select>
      )}
    </>
  );
}

function ToleranceField({ label, which, help }: { label: string; which: "absolute" | "relative"; help: string }) {
  return (
    <label class="o" title={help}>
      <span class="q">{which}</span>{" "}
      <span class="field small num" style={{ width: "60px" }}>
        <input
          aria-label={label}
          placeholder="0"
          value={tolerance.value[which] || ""}
          onChange={(event) => {
            const typed = parseNumber(event.currentTarget.value || "0");
            if (typed !== null && typed >= 0) tolerance.value = { ...tolerance.value, [which]: typed };
          }}
        />
      </span>
    </label>
  );
}

function FileList() {
  const { files, descriptions: described } = folder.value;
  return (
    <section class="pane fl">
      <div class="head">
        <h2>Calibration files</h2>
        <span class="right">
          <label class="btn small">
            <Icon name="plus" />
            Add
            <input type="file" multiple hidden onChange={(event) => addFiles([...(event.currentTarget.files ?? [])])} />
          </label>
        </span>
      </div>
      {files.length === 0 && (
        <p class="pad q">
          No calibration file is in the folder of the project. Drop a DCM, CDFX, CVX, Excel, MATLAB, JSON or MSQ file
          here, or an image with its A2L file.
        </p>
      )}
      {files.map((file) => (
        <button
          class={`file-row ${sides.second.value === `file:${file.name}` ? "on" : ""}`}
          data-file={file.name}
          title={`${file.name}: compare it with ${sides.first.value === "now" ? "the present values" : "the first set"}`}
          onClick={() => {
            if (sides.second.value.toLowerCase().endsWith(".a2l")) shown.value = "differences";
            sides.second.value = `file:${file.name}`;
          }}
        >
          <Icon name="file" />
          <span class="cut">{file.name}</span>
          <span class="tag">{file.format}</span>
        </button>
      ))}
      {described.map((name) => (
        <button
          class={`file-row ${sides.second.value === `file:${name}` ? "on" : ""}`}
          data-file={name}
          title={`${name}: its labels; choose it beside an image`}
          onClick={() => {
            sides.second.value = `file:${name}`;
            shown.value = "contents";
          }}
        >
          <Icon name="file" kind="q" />
          <span class="cut q">{name}</span>
          <span class="tag">A2L</span>
        </button>
      ))}
    </section>
  );
}

const matching = (row: LabelDifference): boolean =>
  search.value
    .toLowerCase()
    .split(/\s+/)
    .filter(Boolean)
    .every((word) => `${row.name} ${row.kind} ${row.function}`.toLowerCase().includes(word));

function Differences() {
  const result = comparison.value;
  const rows = (result?.rows ?? []).filter(matching);
  const all = rows.length > 0 && rows.every((row) => ticked.value.has(row.label));
  const move = (event: KeyboardEvent) => {
    const at =
      rows.findIndex((row) => row.label === chosen.value) +
      (event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0);
    if (event.key === " ") toggle(chosen.value);
    else if (event.key.startsWith("Arrow") && rows[at]) chosen.value = rows[at]!.label;
    else return;
    event.preventDefault();
  };
  return (
    <section class="pane df">
      <div class="head">
        <h2>Differences</h2>
        <span class="sub">{result ? `${result.labels[0]} and ${result.labels[1]}` : ""}</span>
        <span class="right">
          <label class="field small" style={{ width: "180px" }}>
            <Icon name="find" kind="q" />
            <input
              placeholder="Name, kind, function"
              aria-label="Search differences"
              value={search.value}
              onInput={(event) => {
                search.value = event.currentTarget.value;
              }}
            />
          </label>
        </span>
      </div>
      {result !== null && result.count === 0 && (
        <p class="pad good">
          <Icon name="done" /> Both hold the same {result.compared} names with the same values, axes and units.
        </p>
      )}
      <div class="items" role="region" tabIndex={0} aria-label="Differences" onKeyDown={move}>
        {rows.length > 0 && (
          <table class="list pt" id="differences">
            <thead>
              <tr>
                <th>
                  <button
                    class={`tick ${all ? "on" : ""}`}
                    role="checkbox"
                    aria-checked={all}
                    aria-label="All"
                    onClick={() => {
                      ticked.value = all ? new Set() : new Set(rows.map((row) => row.label));
                    }}
                  >
                    {all && <Icon name="done" />}
                  </button>
                </th>
                <th>name</th>
                <th>kind</th>
                <th class="num" title="Largest difference of two values, in the unit of the values">
                  largest
                </th>
                <th class="num">differ</th>
                <th>at</th>
                <th>also</th>
              </tr>
            </thead>
            <tbody>
              {rows.map((row) => (
                <DifferenceRow row={row} labels={result!.labels} />
              ))}
            </tbody>
          </table>
        )}
      </div>
      {(result?.findings ?? []).map((text) => (
        <p class="note warn">{text}</p>
      ))}
    </section>
  );
}

function toggle(label: string): void {
  ticked.value = flipped(ticked.value, label);
}

function DifferenceRow({ row, labels }: { row: LabelDifference; labels: [string, string] }) {
  const on = ticked.value.has(row.label);
  const others = row.aspects.filter((each) => each.aspect !== "values" && each.aspect !== "presence");
  const details = row.aspects
    .map(
      (each) =>
        `${each.aspect}: ${each.first || MISSING} → ${each.second || MISSING}${each.place ? ` at ${each.place}` : ""}`,
    )
    .join("\n");
  return (
    <tr
      class={row.label === chosen.value ? "on" : ""}
      data-name={row.name}
      title={details}
      onClick={() => {
        chosen.value = row.label;
      }}
    >
      <td>
        <button
          class={`tick ${on ? "on" : ""}`}
          role="checkbox"
          aria-checked={on}
          aria-label={`Take ${row.name}`}
          disabled={row.only === "first"}
          onClick={(event) => {
            event.stopPropagation();
            toggle(row.label);
          }}
        >
          {on && <Icon name="done" />}
        </button>
      </td>
      <td>
        <b>{row.name}</b>
        {row.function && <span class="q"> {row.function}</span>}
      </td>
      <td class="q">{row.kind}</td>
      <td class="num ink">
        {row.largest === null ? MISSING : significant(row.largest)} <span class="q">{unitText(row.unit)}</span>
      </td>
      <td class="num">{row.total > 1 ? `${row.differ} of ${row.total}` : ""}</td>
      <td class="q cut place" title={row.place}>
        {row.place}
      </td>
      <td>
        {row.only ? (
          <span class={`tag ${row.only === "first" ? "b" : "g"}`}>
            only in {row.only === "first" ? labels[0] : labels[1]}
          </span>
        ) : (
          others.map((each) => <span class="tag w">{each.aspect}</span>)
        )}
      </td>
    </tr>
  );
}

function PairPane() {
  const own = pair.value;
  const result = comparison.value;
  if (own === null || result === null)
    return (
      <section class="pane pc">
        <div class="head">
          <h2>{MISSING}</h2>
        </div>
        <p class="pad q">Choose a row: both tables and their difference appear here.</p>
      </section>
    );
  const { first, second } = own;
  const side = first?.axes.some((axis) => axis.input) ? first : (second ?? first);
  const same =
    first !== null &&
    second !== null &&
    first.values.length === second.values.length &&
    first.axes.length === second.axes.length &&
    !first.text;
  const numbers = (each: LabelValues): number[] => each.values.map((value) => value ?? NaN);
  return (
    <section class="pane pc">
      <div class="head">
        <h2>{own.name}</h2>
        <span class="sub">
          {side
            ? [
                side.description,
                side.unit,
                side.axes
                  .map((axis) => (axis.unit ? `${axis.input} [${axis.unit}]` : axis.input))
                  .filter(Boolean)
                  .join(", "),
              ]
                .filter(Boolean)
                .join(" · ")
            : ""}
        </span>
      </div>
      {same ? (
        <Pictures
          axes={first.axes.some((axis) => axis.input) ? first.axes : second.axes}
          first={numbers(first)}
          second={numbers(second)}
          unit={second.unit}
          titles={result.labels}
        />
      ) : (
        <div class="tri two">
          {(
            [
              [result.labels[0], first],
              [result.labels[1], second],
            ] as const
          ).map(([title, each]) =>
            each === null ? (
              <div class="tc">
                <div class="tt">
                  <b class="cut">{title}</b>
                  <span class="q">does not have it</span>
                </div>
              </div>
            ) : each.text ? (
              <div class="tc">
                <div class="tt">
                  <b class="cut">{title}</b>
                </div>
                <p class="pad mono">{each.text}</p>
              </div>
            ) : (
              <Column
                title={`${title}: ${each.axes.map((axis) => axis.points.length).join(" x ") || plain(each.values[0] ?? NaN)}`}
                axes={each.axes}
                unit={each.unit}
                values={numbers(each)}
              />
            ),
          )}
        </div>
      )}
    </section>
  );
}
