// The parameters: a list, what the fit may do with each, and the editor of one.

import { computed } from "@preact/signals";
import { useLayoutEffect, useRef } from "preact/hooks";
import { folder, source } from "../calibrations";
import { nameOfSet } from "../comparison";
import { extent } from "../drawing/canvas";
import { height as heightColour } from "../drawing/colours";
import { count, MISSING, plain, significant } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { areAll, fitOnly, toggleLocks, togglePins, whyUnfit } from "../instruments/cell-marks";
import { EvidencePane } from "../instruments/evidence";
import { applyEdit, MapTable, type Shown, shownMarks } from "../instruments/map-table";
import { Proposals } from "../instruments/proposals";
import { SettingsButton } from "../instruments/settings-panel";
import { Slice } from "../instruments/slices";
import { Surface } from "../instruments/surface";
import { cellAt, cellsOf } from "../instruments/table-cells";
import { describeCells, readEdit } from "../instruments/table-edits";
import { panel } from "../navigation";
import type { EditedTable, ParameterRow } from "../replies";
import { scoped } from "../scope";
import { blocking, open, openName, referenceName, request, screen, selection, state, table } from "../store";
import { CoverageChips } from "./parameters/coverage-chips";
import { ParameterSettings } from "./parameters/settings";
import { Properties } from "./properties";

const search = scoped("");
const filter = scoped<"all" | "changed" | "at bound" | "no data">("all");
const sorting = scoped<keyof typeof SORTINGS>("name");

const FILTERS = {
  all: () => true,
  changed: (p: ParameterRow) => p.changed > 0,
  "at bound": (p: ParameterRow) => p.atBound > 0,
  "no data": (p: ParameterRow) => p.withoutData > 0,
} as const;

/** Orders of the list: what needs attention first. */
const SORTINGS = {
  name: null,
  change: (p: ParameterRow) => p.change ?? 0,
  weakness,
  unused: (p: ParameterRow) => (p.unused ? 2 : p.withoutData / size(p)),
} as const;
const TITLES: Record<keyof typeof SORTINGS, string> = {
  name: "As the function names them",
  change: "Largest change against the reference first, relative to the largest value",
  weakness: "Least known first: median standard deviation relative to the span of the table",
  unused: "Without effect or data first, then by the share of values without data",
};

const size = (p: ParameterRow): number => p.shape.reduce((product, length) => product * length, 1);

/** How little is known of a parameter: undetermined before known ones; without a run, by its share without data. */
function weakness(p: ParameterRow): number {
  if (p.undetermined) return Number.MAX_VALUE;
  return p.deviation ?? (p.unused ? Number.MAX_VALUE : p.withoutData / size(p));
}

function sorted(rows: ParameterRow[]): ParameterRow[] {
  const rank = SORTINGS[sorting.value];
  return rank === null ? rows : rows.toSorted((a, b) => rank(b) - rank(a));
}

/** What the sorting goes by, beside the name of the parameter. */
function sortedBy(p: ParameterRow): string {
  if (sorting.value === "change") return p.change ? `${significant(p.change * 100, 2)} %` : "";
  if (sorting.value === "unused") return p.unused ? "unused" : p.withoutData ? `${p.withoutData} empty` : "";
  if (sorting.value !== "weakness") return "";
  if (p.undetermined) return "open";
  return p.deviation === null ? "" : `± ${significant(p.deviation * 100, 2)} %`;
}

export function Parameters() {
  const own = table.value;
  return (
    <>
      <main class={`parameters ${panel.parameters.value ? "open" : ""}`}>
        <List />
        <Bar own={own} />
        {own === null ? (
          <section class="pane none">
            <p class="pad q">
              {blocking.value === null
                ? "No parameter is open."
                : "The parameters are listed here once the project can be evaluated: see the message above."}
            </p>
            <Proposals />
          </section>
        ) : (
          <Editor own={own} />
        )}
        <ParameterSettings />
      </main>
      <Footer>
        <Key keys={["Enter"]} text="set all" />
        <Key keys={["+", "−"]} text="step" />
        <Key keys={["=", "*", "/"]} text="arithmetic" />
        <Key keys={["i"]} text="interpolate" />
        <Key keys={["s"]} text="smooth" />
        <Key keys={["l"]} text="lock" />
        <Key keys={["p"]} text="pin" />
        <Key keys={["e"]} text="evidence" />
        <Key keys={["Del"]} text="reference" />
      </Footer>
    </>
  );
}

function List() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const all = state.value.parameters;
  const visible = all.filter(
    (p) =>
      FILTERS[filter.value](p) &&
      words.every((word) => `${p.name} ${p.kind} ${p.unit} ${p.description}`.toLowerCase().includes(word)),
  );
  return (
    <section class="pane list" aria-label="Parameters">
      <div class="head">
        <h2>Parameters</h2>
        <span class="right q">{count(state.value.freeValues)} values free</span>
      </div>
      <div class="filter">
        <label class="field" style={{ width: "100%" }}>
          <Icon name="find" kind="q" />
          <input
            placeholder="Name, kind, unit"
            aria-label="Search parameters"
            value={search.value}
            onInput={(event) => {
              search.value = event.currentTarget.value;
            }}
          />
        </label>
        <div class="chips">
          {(Object.keys(FILTERS) as (keyof typeof FILTERS)[]).map((name) => (
            <button
              class="chip"
              aria-pressed={filter.value === name}
              onClick={() => {
                filter.value = name;
              }}
            >
              {name} <i>{all.filter(FILTERS[name]).length}</i>
            </button>
          ))}
          <select
            class="field small"
            aria-label="Sort the parameters"
            title={TITLES[sorting.value]}
            value={sorting.value}
            onChange={(event) => {
              sorting.value = event.currentTarget.value as keyof typeof SORTINGS;
            }}
          >
            {(Object.keys(SORTINGS) as (keyof typeof SORTINGS)[]).map((name) => (
              <option value={name} title={TITLES[name]}>
                by {name}
              </option>
            ))}
          </select>
        </div>
      </div>
      <div class="items">
        {sorted(visible).map((p) => (
          <Item key={p.name} own={p} />
        ))}
      </div>
      {isOpen.value && <OpenProperties />}
    </section>
  );
}

const isOpen = computed(() => table.value !== null);

function OpenProperties() {
  return table.value === null ? null : <Properties own={table.value} />;
}

function Item({ own }: { own: ParameterRow }) {
  const on = own.name === openName.value;
  return (
    <div
      class={`item ${on ? "on" : ""}`}
      data-parameter={own.name}
      tabIndex={0}
      role="button"
      aria-pressed={on}
      title={own.description}
      onClick={() => open(own.name)}
      onKeyDown={(event) => {
        if (event.key === "Enter" || event.key === " ") open(own.name);
      }}
    >
      <Thumbnail own={own} />
      <div class="grow">
        <b class="cut">{own.name}</b>
        <small>
          {own.kind} {own.shape.join(" × ")}
          {own.unit && own.unit !== "-" ? ` · ${own.unit}` : ""}
        </small>
      </div>
      <span class="q by">{sortedBy(own)}</span>
      {own.changed > 0 && <span class="dotmark" title="changed" />}
    </div>
  );
}

function Thumbnail({ own }: { own: ParameterRow }) {
  const [rows, canvas] = [own.thumbnail, useRef<HTMLCanvasElement>(null)];
  const [nx, ny] = [rows.length, rows[0]?.length ?? 0];
  const values = rows.flat();
  useLayoutEffect(() => paintThumbnail(canvas.current, rows), [values.join(" ")]);
  if (nx === 0) return <svg class="thumb" aria-hidden="true" />;
  if (ny > 1) return <canvas class="thumb" ref={canvas} width={nx} height={ny} aria-hidden="true" />;
  const [low, high] = extent(values);
  const points = values
    .map(
      (value, k) =>
        `${2 + (26 * k) / Math.max(1, nx - 1)},${17 - 14 * (high > low ? (value - low) / (high - low) : 0.5)}`,
    )
    .join(" ");
  return (
    <svg class="thumb" aria-hidden="true">
      <polyline fill="none" stroke="var(--model)" stroke-width="1.5" points={points} />
    </svg>
  );
}

/** Paint a pixel for each value, y upwards. */
function paintThumbnail(canvas: HTMLCanvasElement | null, rows: number[][]): void {
  if (canvas === null) return;
  const pen = canvas.getContext("2d")!;
  const [low, high] = extent(rows.flat());
  const image = pen.createImageData(canvas.width, canvas.height);
  rows.forEach((row, i) =>
    row.forEach((value, j) => {
      const colour = heightColour(high > low ? (value - low) / (high - low) : 0.5);
      image.data.set([...colour, 255], 4 * ((row.length - 1 - j) * rows.length + i));
    }),
  );
  pen.putImageData(image, 0, 0);
}

function Bar({ own }: { own: EditedTable | null }) {
  const shown = shownMarks.value;
  const set = (part: Partial<Shown>) => {
    shownMarks.value = { ...shownMarks.value, ...part };
  };
  return (
    <section class="pane bar1">
      <div class="head">
        <h2>{own?.name ?? MISSING}</h2>
        <span class="sub">{[own?.description, own?.unit].filter(Boolean).join(" · ")}</span>
        <div class="right">
          <span class="seg">
            {(
              [
                ["value", "Value"],
                ["difference", "Difference"],
                ["percent", "in %"],
              ] as const
            ).map(([mode, text]) => (
              <button aria-pressed={shown.mode === mode} onClick={() => set({ mode })}>
                {text}
              </button>
            ))}
          </span>
          <ReferenceChoice />
          <span class="sep" />
          <button class="chip" aria-pressed={shown.empty} onClick={() => set({ empty: !shown.empty })}>
            <span class="sw hatched" />
            no data
          </button>
          <button class="chip" aria-pressed={shown.deviation} onClick={() => set({ deviation: !shown.deviation })}>
            <span class="sw bar2" />
            std dev
          </button>
          <CoverageChips own={own} />
          <span class="sep" />
          <SettingsButton own={panel.parameters} first="parameters" />
        </div>
      </div>
    </section>
  );
}

/** What the values are compared with: the last run, or else what is chosen here. */
function ReferenceChoice() {
  const { reference, runs } = state.value;
  const files = folder.value.files.map((each) => `file:${each.name}`);
  const known = ["start", ...runs.map((run) => String(run.number)), ...files];
  const options = known.includes(reference.key) ? known : [...known, reference.key];
  const last = runs.at(-1);
  const automatic = last === undefined ? "start" : `run ${last.number}, last`;
  return (
    <label class="against">
      <span class="q">against</span>
      <select
        class="field small"
        aria-label="Compare with"
        title={`Compared with ${referenceName.value}`}
        value={reference.chosen ? reference.key : ""}
        onChange={(event) => {
          const { value } = event.currentTarget;
          void request("choose-reference", { source: value === "" ? null : source(value) });
        }}
      >
        <option value="">{automatic}</option>
        {options.map((key) => (
          <option value={key}>{nameOfSet(key)}</option>
        ))}
      </select>
    </label>
  );
}

function Editor({ own }: { own: EditedTable }) {
  if (own.kind === "rbf")
    return (
      <section class="pane tbl">
        <p class="pad q">
          A data-driven model with {count(own.values.length)} values, which are trained, not edited.{" "}
          <button
            class="btn small"
            onClick={() => {
              screen.value = "function";
            }}
          >
            Training and errors
          </button>
        </p>
      </section>
    );
  return (
    <>
      <section class="pane tbl">
        <div class="scroll">
          <MapTable own={own} />
        </div>
        <SelectionBar own={own} />
      </section>
      {own.axes.length === 2 && (
        <section class="pane surf">
          <div class="head">
            <h2>Surface</h2>
            <span class="key">
              <i style={{ borderColor: "var(--accent)", borderTopWidth: "3px" }} />
              now
            </span>
            <span class="key">
              <i style={{ borderColor: "var(--before)" }} />
              {referenceName.value}
            </span>
            <span class="sub right">drag the dot up or down, the ground to turn</span>
          </div>
          <Surface own={own} />
        </section>
      )}
      <EvidencePane own={own} />
      {own.axes.length > 0 && own.axes.length < 3 && (
        <section class={`pane slic ${own.axes.length === 1 ? "wide" : ""}`}>
          <div class="head">
            <h2>{own.axes.length === 1 ? "Curve" : "Slices"}</h2>
            <span class="sub">{own.axes.length === 1 ? "drag the points" : "through the point"}</span>
          </div>
          <div class="two">
            {own.axes.map((_, axis) => (
              <Slice own={own} axis={axis as 0 | 1} />
            ))}
          </div>
        </section>
      )}
    </>
  );
}

function SelectionBar({ own }: { own: EditedTable }) {
  const chosen = selection.value;
  const values = cellsOf(own, chosen).map((cell) => own.values[cell]!);
  const [least, greatest] = extent(values);
  const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
  const reach = (axis: 0 | 1, [from, to]: [number, number]) => {
    const points = own.axes[axis]?.points;
    if (!points) return "";
    return from === to ? plain(points[from]!, 4) : `${plain(points[from]!, 4)} … ${plain(points[to]!, 4)}`;
  };
  return (
    <div class="selbar">
      <span class="ink fixed">
        {chosen.x[1] - chosen.x[0] + 1} × {chosen.y[1] - chosen.y[0] + 1}
      </span>
      <span class="cut reach">
        {own.axes.slice(0, 2).map((axis, k) => (
          <>
            <span class="q">{axis.input}</span> {reach(k as 0 | 1, k === 0 ? chosen.x : chosen.y)}{" "}
          </>
        ))}
      </span>
      <span class="sep" />
      <span class="cut stats">
        <span class="q">least</span> {significant(least)} <span class="q">mean</span> {significant(mean)}{" "}
        <span class="q">greatest</span> {significant(greatest)}
      </span>
      <CellMarks own={own} />
      <ValueField own={own} />
    </div>
  );
}

/** Locks, pins, and a fit of the selection alone. */
function CellMarks({ own }: { own: EditedTable }) {
  const [locked, pinned, unfit] = [areAll(own, own.locked), areAll(own, own.pinned), whyUnfit(own)];
  return (
    <span class="marks right">
      <button
        class="btn small"
        aria-pressed={locked}
        title={`${locked ? "Let the fit change the selected values" : "Keep the selected values in every fit"} (l)`}
        onClick={() => toggleLocks(own)}
      >
        {locked ? "Unlock" : "Lock"}
      </button>
      <button
        class="btn small"
        aria-pressed={pinned}
        title={`${pinned ? "Remove the pins of the selected values" : "Fix the table here at the present values, also if breakpoints move"} (p)`}
        onClick={() => togglePins(own)}
      >
        {pinned ? "Unpin" : "Pin"}
      </button>
      <button
        class="btn small"
        disabled={unfit !== ""}
        title={
          unfit
            ? `The selection cannot be fitted: ${unfit}`
            : "Fit this selection: a run in which all other values are held"
        }
        onClick={() => fitOnly(own)}
      >
        Fit
      </button>
    </span>
  );
}

/** Sets the selected values, as typing into the table does. */
function ValueField({ own }: { own: EditedTable }) {
  const value = own.values[cellAt(own, ...selection.value.active)]!;
  const enter = (event: KeyboardEvent & { currentTarget: HTMLInputElement }) => {
    const input = event.currentTarget;
    if (event.key === "Escape") input.value = plain(value, 6);
    if (event.key !== "Enter") return;
    const edit = readEdit(input.value);
    if (edit === null) input.value = plain(value, 6);
    else applyEdit(own, edit);
    input.select();
  };
  return (
    <span class="row">
      <input
        class="field small num"
        aria-label={`Value of ${describeCells(own, selection.value)}`}
        title={`Sets the selected values (${own.unit || "no unit"}).\n=5 sets, *1.1 scales, +2 adds; Enter applies`}
        value={plain(value, 6)}
        onFocus={(event) => event.currentTarget.select()}
        onKeyDown={enter}
        onBlur={(event) => {
          event.currentTarget.value = plain(value, 6);
        }}
      />
      <span class="q">{own.unit}</span>
    </span>
  );
}
