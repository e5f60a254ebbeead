// The results: two sets of values side by side, what to accept, and what the data cannot determine.

import {
  accept,
  changes,
  choiceScore,
  chosen,
  first,
  keepAll,
  keptCount,
  ranked,
  ranking,
  rejected,
  scores,
  second,
  shown,
  valueCount,
} from "../comparison";
import { MISSING, plain, signed, significant } from "../drawing/numbers";
import { Segment } from "../fields";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { Pictures } from "../instruments/pictures";
import type { ComparedTable } from "../replies";
import { open, screen, state } from "../store";
import { ByFilePane } from "./results/by-file";
import { ExportPane } from "./results/export";
import { IfPinned } from "./results/pinned";
import { TrustPane } from "./results/trust";

export function Results() {
  const own = shown.value;
  const options = ["start", "now", ...state.value.runs.map((run) => String(run.number))];
  return (
    <>
      <main class="results">
        <section class="pane bar">
          <div class="head">
            <h2>Compare</h2>
            <Choice label="First" value={first} options={options} />
            <span class="q">with</span>
            <Choice label="Second" value={second} options={options} />
            <span class="sep" />
            <span class="scores">
              {scores.value.map((score) => (
                <>
                  <span class="q">
                    {score.use}
                    {state.value.criteria.length > 1 ? ` ${score.criterion}` : ""}
                  </span>
                  <span class="ink">
                    {number(score.first)} → {number(score.second)} {score.unit}
                  </span>
                  <span class="q">greatest {number(score.largest)}</span>
                  <span class="sep" />
                </>
              ))}
            </span>
            <span class="right">
              <AcceptButton />
            </span>
          </div>
        </section>
        <section class="pane li">
          <div class="head">
            <h2>Changes</h2>
            <span class="sub">biggest first</span>
            <span class="right">
              <Segment
                label="Rank by"
                options={["max", "mean"]}
                chosen={ranking.value}
                choose={(option) => {
                  ranking.value = option as typeof ranking.value;
                }}
              />
            </span>
          </div>
          <div class="items">
            {ranked.value.map((each) => (
              <ChangeItem own={each} />
            ))}
          </div>
          {own && <CellList own={own} />}
        </section>
        <section class="pane mp">
          <div class="head">
            <h2>{own?.name ?? MISSING}</h2>
            <span class="sub">{own ? describe(own) : ""}</span>
            {own && (
              <span class="right">
                {choiceScore.value && (
                  <span class="q" id="choice">
                    RMSE with this choice <b class="ink">{number(choiceScore.value.rmse)}</b> {choiceScore.value.unit}
                  </span>
                )}
                <button
                  class="btn small"
                  onClick={() => {
                    open(own.name);
                    screen.value = "parameters";
                  }}
                >
                  Edit
                </button>
              </span>
            )}
          </div>
          {own && <Pictures {...own} titles={[first.value, second.value]} hatched={rejected.value[own.name]} />}
        </section>
        <div class="lower">
          <ByFilePane />
          <TrustPane />
        </div>
        <section class="pane ep">
          <IfPinned />
          <ExportPane />
        </section>
      </main>
      <Footer>
        <Key keys={["Space"]} text="accept or keep" />
        <Key keys={["Ctrl", "E"]} text="export" />
      </Footer>
    </>
  );
}

const number = (value: number | null): string => (value === null ? MISSING : significant(value));

function Choice({ label, value, options }: { label: string; value: { value: string }; options: string[] }) {
  return (
    <select
      class="field small"
      aria-label={label}
      value={value.value}
      onChange={(event) => {
        value.value = event.currentTarget.value;
      }}
    >
      {options.map((each) => (
        <option value={each}>{/^\d+$/.test(each) ? `run ${each}` : each}</option>
      ))}
    </select>
  );
}

function describe(own: ComparedTable): string {
  const axes = own.axes.map((axis) => (axis.unit ? `${axis.input} [${axis.unit}]` : axis.input)).filter(Boolean);
  return [own.description, [own.unit, axes.length ? `over ${axes.join(" and ")}` : ""].filter(Boolean).join(" ")]
    .filter(Boolean)
    .join(" · ");
}

function ChangeItem({ own }: { own: ComparedTable }) {
  const widest = Math.max(...changes.value.map((each) => each.relative), 1e-12);
  const kept = rejected.value[own.name]?.size ?? 0;
  return (
    <div
      class={`pi ${own.name === shown.value?.name ? "on" : ""}`}
      data-parameter={own.name}
      tabIndex={0}
      onClick={() => {
        chosen.value = own.name;
      }}
      onKeyDown={(event) => {
        if (event.key === " ") {
          toggleAll(own);
          event.preventDefault();
        }
        if (event.key === "Enter") chosen.value = own.name;
      }}
    >
      <Tick
        on={kept === 0}
        half={kept > 0 && kept < own.first.length}
        label={`Accept ${own.name}`}
        toggle={() => toggleAll(own)}
      />
      <div class="grow">
        <div class="r1">
          <b class="cut">{own.name}</b>
          <span class="ink">
            {significant(own.largest, 3)} <span class="q">{own.unit}</span>
          </span>
        </div>
        <div class="r2">
          <span class="bar q" style={{ width: `${(own.relative / widest) * 110}px` }} />
          <span class="q">
            mean {significant(own.mean, 3)}
            {own.atBound ? `, ${own.atBound} at a bound` : ""}
          </span>
        </div>
      </div>
    </div>
  );
}

function Tick({ on, half = false, label, toggle }: { on: boolean; half?: boolean; label: string; toggle: () => void }) {
  return (
    <button
      class={`tick ${on ? "on" : half ? "half" : ""}`}
      role="checkbox"
      aria-checked={half ? "mixed" : on}
      aria-label={label}
      onClick={(event) => {
        event.stopPropagation();
        toggle();
      }}
    >
      {on && <Icon name="done" />}
    </button>
  );
}

function toggleAll(own: ComparedTable): void {
  const kept = rejected.value[own.name]?.size ?? 0;
  rejected.value = { ...rejected.value, [own.name]: kept ? new Set() : new Set(own.first.map((_, k) => k)) };
}

function toggle(own: ComparedTable, cell: number): void {
  const kept = new Set(rejected.value[own.name]);
  if (!kept.delete(cell)) kept.add(cell);
  rejected.value = { ...rejected.value, [own.name]: kept };
}

function CellList({ own }: { own: ComparedTable }) {
  const kept = rejected.value[own.name] ?? new Set<number>();
  const place = (cell: number): string[] => {
    let rest = cell;
    return own.axes
      .toReversed()
      .map((axis) => {
        const at = rest % axis.points.length;
        rest = Math.floor(rest / axis.points.length);
        return plain(axis.points[at]!, 5);
      })
      .toReversed();
  };
  return (
    <>
      <div class="head mid">
        <h2>{own.name}</h2>
        <span class="right q">
          {own.first.length - kept.size} of {own.first.length} values accepted
        </span>
      </div>
      <div class="items cells">
        <table class="list pt">
          <thead>
            <tr>
              <th />
              {own.axes.map((axis) => (
                <th class="num">{axis.unit || axis.input}</th>
              ))}
              <th class="num">{first.value}</th>
              <th class="num">{second.value}</th>
              <th class="num">change</th>
            </tr>
          </thead>
          <tbody>
            {own.biggest.slice(0, 100).map((cell) => (
              <tr class={kept.has(cell) ? "off" : ""}>
                <td>
                  <Tick
                    on={!kept.has(cell)}
                    label={`Accept the value at ${place(cell).join(", ")}`}
                    toggle={() => toggle(own, cell)}
                  />
                </td>
                {place(cell).map((text) => (
                  <td class="num">{text}</td>
                ))}
                <td class="num q">{significant(own.first[cell]!)}</td>
                <td class={`num ink ${own.bound.includes(cell) ? "bad" : ""}`}>{significant(own.second[cell]!)}</td>
                <td class="num ink">{signed(own.second[cell]! - own.first[cell]!)}</td>
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
  const kept = keptCount.value;
  return (
    <>
      <span class="q">
        accepted {valueCount.value - kept} of {valueCount.value}
      </span>{" "}
      <button
        class="btn small"
        id="keep-all"
        title="Keep the start of every value, or accept every value"
        onClick={() => keepAll(kept < valueCount.value)}
      >
        {kept < valueCount.value ? "None" : "All"}
      </button>{" "}
      <button class="btn primary" id="accept" style={{ height: "22px" }} onClick={accept}>
        {kept ? "Accept the choice" : "Accept the run"}
      </button>
    </>
  );
}
