// What differs between two sets: each table with its biggest change, and the grid points of one, both to be ticked.

import { useSignal } from "@preact/signals";
import {
  changes,
  chosen,
  first,
  nameOfSet,
  type Ranking,
  ranked,
  ranking,
  second,
  shown,
  takenOf,
  taking,
  tick,
  tickAll,
} from "../../comparison";
import { plain, signed, significant } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import type { ComparedTable } from "../../replies";
import { open, screen } from "../../store";

const MOST = 100; // grid points that are listed

export function ChangesPane() {
  const own = shown.value;
  return (
    <section class="pane chg" aria-label="Changes">
      <div class="head">
        <h2>Changes</h2>
        <span class="sub">B − A, biggest first</span>
        <span class="right">
          <span class="q">by</span>
          <Segment
            label="Rank by"
            options={["absolute", "relative", "mean"]}
            chosen={ranking.value}
            choose={(option) => {
              ranking.value = option as Ranking;
            }}
          />
        </span>
      </div>
      <table class="list cg">
        <thead>
          <tr>
            {taking.value !== "whole" && (
              <th>
                <span class="unseen">take</span>
              </th>
            )}
            <th>parameter</th>
            <Sorted by="absolute" text="most" />
            <th>at</th>
            <Sorted by="relative" text="of largest" />
            <Sorted by="mean" text="mean" />
            <th class="num">at a bound</th>
            {taking.value !== "whole" && <th class="num">take</th>}
          </tr>
        </thead>
        <tbody>
          {ranked.value.map((each) => (
            <ChangeRow key={each.name} own={each} />
          ))}
        </tbody>
      </table>
      {changes.value.length > 0 && changes.value.every((each) => each.largest === 0) && (
        <p class="pad q">
          {nameOfSet(first.value)} and {nameOfSet(second.value)} have the same values.
        </p>
      )}
      {own && own.biggest.length > 0 && own.axes.length > 0 && <PointList key={own.name} own={own} />}
    </section>
  );
}

function Sorted({ by, text }: { by: Ranking; text: string }) {
  return (
    <th class="num" aria-sort={ranking.value === by ? "descending" : "none"}>
      <button
        class="link sort"
        onClick={() => {
          ranking.value = by;
        }}
      >
        {text}
        {ranking.value === by ? " ▾" : ""}
      </button>
    </th>
  );
}

function ChangeRow({ own }: { own: ComparedTable }) {
  const taken = takenOf(own).size;
  const [cell] = own.biggest;
  const change = cell === undefined ? 0 : own.second[cell]! - own.first[cell]!;
  return (
    <tr
      class={own.name === shown.value?.name ? "on" : ""}
      data-change={own.name}
      tabIndex={0}
      onClick={() => {
        chosen.value = own.name;
      }}
      onKeyDown={(event) => {
        if (event.key === "Enter") chosen.value = own.name;
        else if (event.key === " " && taking.value !== "whole") {
          tickAll(own, taken < own.first.length);
          event.preventDefault();
        }
      }}
    >
      {taking.value !== "whole" && (
        <td>
          <Tick
            on={taken === own.first.length}
            half={taken > 0 && taken < own.first.length}
            label={`Take ${own.name}`}
            toggle={() => tickAll(own, taken < own.first.length)}
          />
        </td>
      )}
      <td class="cut" title={own.description}>
        <b>{own.name}</b>
      </td>
      <td class="num ink">
        {change === 0 ? "0" : signed(change)} {own.unit === "-" ? "" : own.unit}
      </td>
      <td class="q">{cell === undefined ? "" : placeOf(own, cell).join(", ")}</td>
      <td class="num ink">{own.largest === 0 ? "0 %" : `${signed(Math.sign(change) * own.relative * 100)} %`}</td>
      <td class="num">{significant(own.mean, 3)}</td>
      <td class="num">{own.atBound > 0 ? <span class="warn">{`${own.atBound} of ${own.first.length}`}</span> : "0"}</td>
      {taking.value !== "whole" && (
        <td class="num">
          {taken} of {own.first.length}
        </td>
      )}
    </tr>
  );
}

export function Tick(props: { on: boolean; half?: boolean; label: string; toggle: () => void }) {
  return (
    <button
      class={`tick ${props.on ? "on" : props.half ? "half" : ""}`}
      role="checkbox"
      aria-checked={props.half ? "mixed" : props.on}
      aria-label={props.label}
      onClick={(event) => {
        event.stopPropagation();
        props.toggle();
      }}
    >
      {props.on && <Icon name="done" />}
    </button>
  );
}

/** The breakpoints of a value. */
export function placeOf(own: ComparedTable, cell: number): string[] {
  let rest = cell;
  return own.axes
    .toReversed()
    .map((axis) => {
      const at = rest % axis.points.length;
      rest = Math.floor(rest / axis.points.length);
      return plain(axis.points[at]!, 5);
    })
    .toReversed();
}

function PointList({ own }: { own: ComparedTable }) {
  const relative = useSignal(false);
  const taken = takenOf(own);
  const byPoint = taking.value === "by grid point";
  const share = (cell: number) => Math.abs((own.second[cell]! - own.first[cell]!) / (own.first[cell]! || 1e-300));
  const cells = relative.value ? own.biggest.toSorted((a, b) => share(b) - share(a)) : own.biggest;
  return (
    <>
      <div class="head mid">
        <h2>{own.name}</h2>
        <span class="sub">
          {byPoint ? `${taken.size} of ${own.first.length} points, ` : ""}most changed first
          {own.biggest.length > MOST ? `, the first ${MOST}` : ""}
        </span>
        <span class="right">
          <button
            class="btn small"
            onClick={() => {
              open(own.name);
              screen.value = "parameters";
            }}
          >
            Edit
          </button>
          {byPoint && (
            <>
              <button class="btn small" onClick={() => tickAll(own, true)}>
                All {own.first.length}
              </button>
              <button class="btn small" onClick={() => tickAll(own, false)}>
                None
              </button>
            </>
          )}
        </span>
      </div>
      <table class="list cg points">
        <thead>
          <tr>
            {byPoint && (
              <th>
                <span class="unseen">take</span>
              </th>
            )}
            {own.axes.map((axis, k) => (
              <th class="num" title={axis.unit}>
                {axis.input || axis.unit || `axis ${k + 1}`}
              </th>
            ))}
            <th class="num">{nameOfSet(first.value)}</th>
            <th class="num">{nameOfSet(second.value)}</th>
            <th class="num" aria-sort={relative.value ? "none" : "descending"}>
              <button
                class="link sort"
                onClick={() => {
                  relative.value = false;
                }}
              >
                change{relative.value ? "" : " ▾"}
              </button>
            </th>
            <th class="num" aria-sort={relative.value ? "descending" : "none"}>
              <button
                class="link sort"
                onClick={() => {
                  relative.value = true;
                }}
              >
                relative{relative.value ? " ▾" : ""}
              </button>
            </th>
          </tr>
        </thead>
        <tbody>
          {cells.slice(0, MOST).map((cell) => (
            <tr key={cell} data-cell={cell}>
              {byPoint && (
                <td>
                  <Tick
                    on={taken.has(cell)}
                    label={`Take the value at ${placeOf(own, cell).join(", ")}`}
                    toggle={() => tick(own, [cell], !taken.has(cell))}
                  />
                </td>
              )}
              {placeOf(own, cell).map((text) => (
                <td class="num">{text}</td>
              ))}
              <td class="num">{significant(own.first[cell]!)}</td>
              <td class={`num ink ${own.bound.includes(cell) ? "bad" : ""}`}>{significant(own.second[cell]!)}</td>
              <td class="num ink">{signed(own.second[cell]! - own.first[cell]!)}</td>
              <td class="num">{relativeText(own, cell)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </>
  );
}

/** The change of a value relative to that of A; of the range of B where A is near 0. */
function relativeText(own: ComparedTable, cell: number): string {
  const [a, b] = [own.first[cell]!, own.second[cell]!];
  const range = Math.max(...own.second) - Math.min(...own.second);
  const near = Math.abs(a) < 0.01 * range;
  const share = near ? (b - a) / range : (b - a) / Math.abs(a);
  return Number.isFinite(share) ? `${signed(share * 100)} %${near ? " of range" : ""}` : "";
}
