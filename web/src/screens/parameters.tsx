// The parameters: a list, what the fit may do with each, and the editor of one.

import { signal } from "@preact/signals";
import { extent } from "../drawing/canvas";
import { css, height as heightColour } from "../drawing/colours";
import { MISSING, count, plain, significant } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { EvidencePane } from "../instruments/evidence";
import { Icon } from "../icons";
import { Proposals } from "../instruments/proposals";
import { MapTable, cellsOf, type Shown } from "../instruments/map-table";
import { Slice } from "../instruments/slices";
import { Surface } from "../instruments/surface";
import { CoverageChips } from "./parameters/coverage-chips";
import { Properties } from "./properties";
import { open, openName, referenceName, selection, state, table, type Parameter, type Table } from "../store";

const search = signal("");
const filter = signal<"all" | "changed" | "at bound" | "no data">("all");
const shown = signal<Shown>({ mode: "value", empty: true, deviation: true });

const FILTERS = {
  all: () => true,
  changed: (p: Parameter) => p.changed > 0,
  "at bound": (p: Parameter) => p.atBound > 0,
  "no data": (p: Parameter) => p.withoutData > 0,
} as const;

export function Parameters() {
  const own = table.value;
  return (
    <>
      <main class="parameters">
        <List />
        <Bar own={own} />
        {own === null ? <section class="pane tbl"><p class="pad q">No parameter is open.</p><Proposals /></section> : <Editor own={own} />}
      </main>
      <Footer>
        <Key keys={["Enter"]} text="set all" />
        <Key keys={["+", "−"]} text="step" />
        <Key keys={["=", "*", "/"]} text="arithmetic" />
        <Key keys={["i"]} text="interpolate" />
        <Key keys={["s"]} text="smooth" />
        <Key keys={["Del"]} text="reference" />
      </Footer>
    </>
  );
}

function List() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const all = state.value.parameters;
  const visible = all.filter((p) => FILTERS[filter.value](p) && words.every((word) => `${p.name} ${p.kind} ${p.unit} ${p.description}`.toLowerCase().includes(word)));
  return (
    <section class="pane list" aria-label="Parameters">
      <div class="head"><h2>Parameters</h2><span class="right q">{count(state.value.freeValues)} values free</span></div>
      <div class="filter">
        <label class="field" style={{ width: "100%" }}><Icon name="find" kind="q" /><input placeholder="Name, kind, unit" aria-label="Search parameters" value={search.value} onInput={(event) => { search.value = event.currentTarget.value; }} /></label>
        <div class="chips">
          {(Object.keys(FILTERS) as (keyof typeof FILTERS)[]).map((name) => (
            <button class="chip" aria-pressed={filter.value === name} onClick={() => { filter.value = name; }}>{name} <i>{all.filter(FILTERS[name]).length}</i></button>
          ))}
        </div>
      </div>
      <div class="items">{visible.map((p) => <Item own={p} />)}</div>
      {table.value !== null && <Properties own={table.value} />}
    </section>
  );
}

function Item({ own }: { own: Parameter }) {
  const on = own.name === openName.value;
  return (
    <div class={`item ${on ? "on" : ""}`} data-parameter={own.name} tabIndex={0} role="button" aria-pressed={on} title={own.description}
      onClick={() => open(own.name)} onKeyDown={(event) => { if (event.key === "Enter" || event.key === " ") open(own.name); }}>
      <Thumbnail own={own} />
      <div class="grow"><b class="cut">{own.name}</b><small>{own.kind} {own.shape.join(" × ")}{own.unit && own.unit !== "-" ? ` · ${own.unit}` : ""}</small></div>
      {own.changed > 0 && <span class="dotmark" title="changed" />}
    </div>
  );
}

function Thumbnail({ own }: { own: Parameter }) {
  const rows = own.thumbnail;
  const [width, height] = [30, 20];
  if (rows.length === 0) return <svg width={width} height={height} aria-hidden="true" />;
  const [low, high] = extent(rows.flat());
  const share = (value: number) => (high > low ? (value - low) / (high - low) : 0.5);
  if (rows[0]!.length === 1) {
    const points = rows.map(([value], k) => `${2 + (26 * k) / Math.max(1, rows.length - 1)},${17 - 14 * share(value!)}`).join(" ");
    return <svg class="thumb" width={width} height={height} aria-hidden="true"><polyline fill="none" stroke="var(--model)" stroke-width="1.5" points={points} /></svg>;
  }
  const [w, h] = [width / rows.length, height / rows[0]!.length];
  return (
    <svg class="thumb" width={width} height={height} aria-hidden="true">
      {rows.flatMap((row, i) => row.map((value, j) => <rect x={i * w} y={height - (j + 1) * h} width={w + 0.4} height={h + 0.4} fill={css(heightColour(share(value)))} />))}
    </svg>
  );
}

function Bar({ own }: { own: Table | null }) {
  const set = (part: Partial<Shown>) => { shown.value = { ...shown.value, ...part }; };
  return (
    <section class="pane bar1">
      <div class="head">
        <h2>{own?.name ?? MISSING}</h2><span class="sub">{[own?.description, own?.unit].filter(Boolean).join(" · ")}</span>
        <div class="right">
          <span class="seg">
            {([["value", "Value"], ["difference", "Difference"], ["percent", "in %"]] as const).map(([mode, text]) => (
              <button aria-pressed={shown.value.mode === mode} onClick={() => set({ mode })}>{text}</button>
            ))}
          </span>
          <span class="sep" />
          <button class="chip" aria-pressed={shown.value.empty} onClick={() => set({ empty: !shown.value.empty })}><span class="sw hatched" />no data</button>
          <button class="chip" aria-pressed={shown.value.deviation} onClick={() => set({ deviation: !shown.value.deviation })}><span class="sw bar2" />std dev</button>
          <CoverageChips own={own} />
        </div>
      </div>
    </section>
  );
}

function Editor({ own }: { own: Table }) {
  return (
    <>
      <section class="pane tbl">
        <div class="scroll"><MapTable own={own} shown={shown.value} /></div>
        <SelectionBar own={own} />
      </section>
      {own.axes.length === 2 && (
        <section class="pane surf">
          <div class="head"><h2>Surface</h2><span class="key"><i style={{ borderColor: "var(--accent)", borderTopWidth: "3px" }} />now</span><span class="key"><i style={{ borderColor: "var(--before)" }} />{referenceName.value}</span><span class="sub right">drag the dot up or down, the ground to turn</span></div>
          <Surface own={own} />
        </section>
      )}
      <EvidencePane own={own} />
      {own.axes.length > 0 && own.axes.length < 3 && (
        <section class={`pane slic ${own.axes.length === 1 ? "wide" : ""}`}>
          <div class="head"><h2>{own.axes.length === 1 ? "Curve" : "Slices"}</h2><span class="sub">{own.axes.length === 1 ? "drag the points" : "through the point"}</span></div>
          <div class="two">{own.axes.map((_, axis) => <Slice own={own} axis={axis as 0 | 1} />)}</div>
        </section>
      )}
    </>
  );
}

function SelectionBar({ own }: { own: Table }) {
  const chosen = selection.value;
  const values = cellsOf(own, chosen).map((cell) => own.values[cell]!);
  const [least, greatest] = extent(values);
  const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
  const reach = (axis: 0 | 1, [from, to]: [number, number]) => {
    const points = own.axes[axis]?.points;
    if (!points) return "";
    return from === to ? plain(points[from]!, 5) : `${plain(points[from]!, 5)} … ${plain(points[to]!, 5)}`;
  };
  return (
    <div class="selbar">
      <span class="ink">{chosen.x[1] - chosen.x[0] + 1} × {chosen.y[1] - chosen.y[0] + 1}</span>
      {own.axes.slice(0, 2).map((axis, k) => <><span class="q">{axis.input}</span> {reach(k as 0 | 1, k === 0 ? chosen.x : chosen.y)}</>)}
      <span class="sep" />
      <span class="q">least</span> {significant(least)} <span class="q">mean</span> {significant(mean)} <span class="q">greatest</span> {significant(greatest)} <span class="q">{own.unit}</span>
    </div>
  );
}
