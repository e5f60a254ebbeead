// The results: two sets of values side by side, what to accept, and what the data cannot determine.

import { effect, signal } from "@preact/signals";
import { accept, changes, chosen, first, pinValues, rejected, scores, second, shown, trust, type Change } from "../comparison";
import { extent, type Pen } from "../drawing/canvas";
import { MISSING, plain, signed, significant } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { drawGrid } from "../drawing/grid";
import { drawCurves } from "../drawing/slices";
import { Picture } from "../instruments/picture";
import { open, request, screen, settled, state, type Axis } from "../store";

export function Results() {
  const own = shown.value;
  const options = ["start", "now", ...state.value.runs.map((run) => String(run.number))];
  return (
    <>
      <main class="results">
        <section class="pane bar">
          <div class="head">
            <h2>Compare</h2><Choice label="First" value={first} options={options} /><span class="q">with</span><Choice label="Second" value={second} options={options} /><span class="sep" />
            {scores.value.map((score) => <><span class="q">{score.use}{state.value.criteria.length > 1 ? ` ${score.criterion}` : ""}</span><span class="ink">{number(score.first)} → {number(score.second)} {score.unit}</span><span class="q">greatest {number(score.largest)}</span><span class="sep" /></>)}
            <span class="right"><AcceptButton /></span>
          </div>
        </section>
        <section class="pane li">
          <div class="head"><h2>Changes</h2><span class="sub">biggest first</span></div>
          <div class="items">{changes.value.map((each) => <ChangeItem own={each} />)}</div>
          {own && <CellList own={own} />}
        </section>
        <section class="pane mp">
          <div class="head"><h2>{own?.name ?? MISSING}</h2><span class="sub">{own ? describe(own) : ""}</span>{own && <span class="right"><button class="btn small" onClick={() => { open(own.name); screen.value = "parameters"; }}>Edit</button></span>}</div>
          {own && <Pictures own={own} />}
        </section>
        <TrustPane />
        <ExportPane />
      </main>
      <Footer><Key keys={["Space"]} text="accept or keep" /><Key keys={["Ctrl", "E"]} text="export" /></Footer>
    </>
  );
}

const number = (value: number | null): string => (value === null ? MISSING : significant(value));

function Choice({ label, value, options }: { label: string; value: { value: string }; options: string[] }) {
  return <select class="field small" aria-label={label} value={value.value} onChange={(event) => { value.value = event.currentTarget.value; }}>{options.map((each) => <option value={each}>{/^\d+$/.test(each) ? `run ${each}` : each}</option>)}</select>;
}

function describe(own: Change): string {
  const axes = own.axes.map((axis) => (axis.unit ? `${axis.input} [${axis.unit}]` : axis.input)).filter(Boolean);
  return [own.description, [own.unit, axes.length ? `over ${axes.join(" and ")}` : ""].filter(Boolean).join(" ")].filter(Boolean).join(" · ");
}

function ChangeItem({ own }: { own: Change }) {
  const widest = Math.max(...changes.value.map((each) => each.relative), 1e-12);
  const kept = rejected.value[own.name]?.size ?? 0;
  return (
    <div class={`pi ${own.name === shown.value?.name ? "on" : ""}`} data-parameter={own.name} tabIndex={0} onClick={() => { chosen.value = own.name; }}
      onKeyDown={(event) => { if (event.key === " ") { toggleAll(own); event.preventDefault(); } if (event.key === "Enter") chosen.value = own.name; }}>
      <Tick on={kept === 0} half={kept > 0 && kept < own.first.length} label={`Accept ${own.name}`} toggle={() => toggleAll(own)} />
      <div class="grow">
        <div class="r1"><b class="cut">{own.name}</b><span class="ink">{significant(own.largest, 3)} <span class="q">{own.unit}</span></span></div>
        <div class="r2"><span class="bar q" style={{ width: `${(own.relative / widest) * 110}px` }} /><span class="q">mean {significant(own.mean, 3)}{own.atBound ? `, ${own.atBound} at a bound` : ""}</span></div>
      </div>
    </div>
  );
}

function Tick({ on, half = false, label, toggle }: { on: boolean; half?: boolean; label: string; toggle: () => void }) {
  return <button class={`tick ${on ? "on" : half ? "half" : ""}`} role="checkbox" aria-checked={half ? "mixed" : on} aria-label={label} onClick={(event) => { event.stopPropagation(); toggle(); }}>{on && <Icon name="done" />}</button>;
}

function toggleAll(own: Change): void {
  const kept = rejected.value[own.name]?.size ?? 0;
  rejected.value = { ...rejected.value, [own.name]: kept ? new Set() : new Set(own.first.map((_, k) => k)) };
}

function toggle(own: Change, cell: number): void {
  const kept = new Set(rejected.value[own.name]);
  if (!kept.delete(cell)) kept.add(cell);
  rejected.value = { ...rejected.value, [own.name]: kept };
}

function CellList({ own }: { own: Change }) {
  const kept = rejected.value[own.name] ?? new Set<number>();
  const place = (cell: number): string[] => {
    let rest = cell;
    return own.axes.toReversed().map((axis) => {
      const at = rest % axis.points.length;
      rest = Math.floor(rest / axis.points.length);
      return plain(axis.points[at]!, 5);
    }).toReversed();
  };
  return (
    <>
      <div class="head mid"><h2>{own.name}</h2><span class="right q">{own.first.length - kept.size} of {own.first.length} values accepted</span></div>
      <div class="items cells">
        <table class="list pt">
          <thead><tr><th />{own.axes.map((axis) => <th class="num">{axis.unit || axis.input}</th>)}<th class="num">{first.value}</th><th class="num">{second.value}</th><th class="num">change</th></tr></thead>
          <tbody>
            {own.biggest.slice(0, 100).map((cell) => (
              <tr class={kept.has(cell) ? "off" : ""}>
                <td><Tick on={!kept.has(cell)} label={`Accept the value at ${place(cell).join(", ")}`} toggle={() => toggle(own, cell)} /></td>
                {place(cell).map((text) => <td class="num">{text}</td>)}
                <td class="num q">{significant(own.first[cell]!)}</td><td class={`num ink ${own.bound.includes(cell) ? "bad" : ""}`}>{significant(own.second[cell]!)}</td><td class="num ink">{signed(own.second[cell]! - own.first[cell]!)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
    </>
  );
}

function AcceptButton() {
  const last = state.value.runs.at(-1);
  if (last === undefined) return <span class="q">A run ends here, to be accepted.</span>;
  const kept = Object.values(rejected.value).reduce((sum, cells) => sum + cells.size, 0);
  return <><span class="q">{kept ? `${kept} values keep their start` : ""}</span> <button class="btn primary" id="accept" style={{ height: "22px" }} onClick={accept}>{kept ? "Accept the choice" : "Accept the run"}</button></>;
}

function rowsOf(own: Change, values: number[]): number[][] {
  const ny = own.axes[1]?.points.length ?? 1;
  return (own.axes[0]?.points ?? [0]).map((_, i) => values.slice(i * ny, (i + 1) * ny));
}

function Pictures({ own }: { own: Change }) {
  const difference = own.second.map((value, k) => value - own.first[k]!);
  const range = extent(own.first, own.second);
  const kept = rejected.value[own.name];
  const ends = (axis: Axis): [number, number] => [axis.points[0]!, axis.points[axis.points.length - 1]!];
  const draw = (values: number[], isDifference: boolean) => (pen: Pen, width: number, height: number) => {
    if (own.axes.length === 2) drawGrid(pen, width, height, { x: ends(own.axes[0]!), y: ends(own.axes[1]!), values: rowsOf(own, values), range: isDifference ? extent(values) : range, difference: isDifference }, (i, j) => {
      const cell = i * own.axes[1]!.points.length + j;
      return kept?.has(cell) ? "hatch" : !isDifference && values === own.second && own.bound.includes(cell) ? "frame" : "";
    });
    else if (own.axes.length === 1) drawCurves(pen, width, height, own.axes[0]!.points, isDifference ? values.map(() => 0) : own.first, values);
  };
  const column = (title: string, values: number[], isDifference: boolean) => {
    const [low, high] = extent(values);
    return (
      <div class="tc">
        <div class="tt"><b>{title}</b><span class="q">{low === high ? significant(low) : `${significant(low, 3)} … ${isDifference ? signed(high) : significant(high, 4)}`} {own.axes.length === 0 ? own.unit : ""}</span></div>
        {own.axes.length > 0 && own.axes.length < 3 && <Picture label={title} draw={draw(values, isDifference)} of={[own, rejected.value]} />}
      </div>
    );
  };
  return <div class="tri">{column(first.value, own.first, false)}{column(second.value, own.second, false)}{column("change", difference, true)}</div>;
}

function TrustPane() {
  const { directions, sentence, advice, remark, pins } = trust.value;
  return (
    <section class="pane dr">
      <div class="head"><h2>What the data cannot determine</h2><span class="sub">{directions.length ? `${directions.length} direction${directions.length > 1 ? "s" : ""}, least known first` : ""}</span></div>
      {!state.value.runs.length && <p class="pad q">After a run this lists changes of the values that the data hardly notice, each with a remedy.</p>}
      {state.value.runs.length > 0 && !directions.length && !sentence && <p class="pad q">{remark || "The data determine all values."}</p>}
      {sentence && <div class="di on"><b class="bad">open</b><div class="grow"><p>{sentence}</p><p class="q">{advice}</p>{pins.length > 0 && <button class="btn small" id="pin" onClick={() => pinValues(pins)}>{pins.length > 1 ? `Pin these ${pins.length} values` : "Pin this value"}</button>}</div></div>}
      {directions.map((each) => (
        <div class="di">
          <b class={each.deviation === null || each.deviation > 20 ? "bad" : each.deviation > 5 ? "warn" : "good"}>{each.deviation === null ? "open" : `± ${significant(each.deviation, 2)}`}</b>
          <div class="grow"><p>{each.sentence}</p><p class="q">{each.remedy}</p></div>
        </div>
      ))}
    </section>
  );
}

const formats = signal<{ formats: string[]; own: string[]; folder: string }>({ formats: [], own: [], folder: "" });
const picked = signal<Set<string> | null>(null);
const extras = signal({ report: true, script: false, whole: false });
const exported = signal<{ files: string[]; findings: string[] }>({ files: [], findings: [] });

effect(() => {
  if (screen.value === "results" && settled.value.project !== null) void request("formats").then((reply) => { if (reply !== null) formats.value = reply.head as unknown as typeof formats.value; });
});

function ExportPane() {
  const { formats: all, own, folder } = formats.value;
  const chosen = picked.value ?? new Set(own);
  const flip = (ending: string) => {
    const next = new Set(chosen);
    if (!next.delete(ending)) next.add(ending);
    picked.value = next;
  };
  const run = async () => {
    const reply = await request("export", { formats: [...chosen], ...extras.value });
    if (reply !== null) exported.value = reply.head as unknown as typeof exported.value;
  };
  const name = (path: string) => path.split(/[\\/]/).at(-1)!;
  const total = chosen.size + Number(extras.value.report) + Number(extras.value.script) + Number(extras.value.whole);
  return (
    <section class="pane ep">
      <div class="head"><h2>Export</h2><span class="sub">present values</span></div>
      <div class="pad">
        <div class="chips">{all.map((ending) => <button class="chip" data-format={ending.slice(1)} aria-pressed={chosen.has(ending)} onClick={() => flip(ending)}>{ending.slice(1).toUpperCase()}</button>)}</div>
        <div class="opt2">
          {([["report", "report.html"], ["script", "Python script that repeats the run"], ["whole", "all files of a run"]] as const).map(([key, text]) => <label><input type="checkbox" checked={extras.value[key]} disabled={key === "whole" && !state.value.runs.length} onChange={(event) => { extras.value = { ...extras.value, [key]: event.currentTarget.checked }; }} /> {text}</label>)}
        </div>
        <p class="q cut" title={folder}>into {folder.split(/[\\/]/).slice(-2).join("/")}</p>
        <div class="go"><button class="btn primary" id="export-files" disabled={!total} onClick={run}>Export</button></div>
        {exported.value.files.length > 0 && <div class="done"><p class="good">Written:</p>{exported.value.files.map((path) => <p class="cut"><a href={`/file/${path.includes("results") ? "results/" : ""}${name(path)}`} download>{name(path)}</a></p>)}</div>}
        {exported.value.findings.map((text) => <p class="note warn">{text}</p>)}
      </div>
    </section>
  );
}
