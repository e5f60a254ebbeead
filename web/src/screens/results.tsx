// The results: two sets of values side by side, what is taken of the second one, and what the data cannot determine.

import {
  changes,
  choice,
  choose,
  countText,
  first,
  history,
  nameOfSet,
  outcome,
  second,
  shown,
  type Taking,
  take,
  takenOf,
  taking,
  tick,
  tickTables,
} from "../comparison";
import { numberText } from "../drawing/numbers";
import { Segment } from "../fields";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import type { MovedTogether } from "../replies";
import { state } from "../store";
import { ByFilePane } from "./results/by-file";
import { ChangesPane } from "./results/changes";
import { ExportPane } from "./results/export";
import { HistoryPane } from "./results/history";
import { LimitsPane } from "./results/limits";
import { IfPinned } from "./results/pinned";
import { Surfaces } from "./results/surfaces";
import { TrustPane } from "./results/trust";

export function Results() {
  const own = shown.value;
  const count = outcome.value?.count ?? 0;
  return (
    <>
      <main class="results">
        <HistoryPane />
        <TakeBar />
        <Together />
        <section class="pictures" aria-label="Both sets">
          {own === undefined ? (
            <p class="pad q">
              {state.value.parameters.length === 0
                ? "Values are compared here once the project can be evaluated."
                : "Nothing to compare yet."}
            </p>
          ) : (
            <Surfaces
              key={own.name}
              own={own}
              taken={takenOf(own)}
              pick={(cell) => {
                taking.value = "by grid point";
                tick(own, [cell], !takenOf(own).has(cell));
              }}
            />
          )}
        </section>
        <ChangesPane />
        <div class="side">
          <LimitsPane />
          <TrustPane />
          <ByFilePane />
          <section class="pane ep">
            <IfPinned />
            <ExportPane />
          </section>
        </div>
      </main>
      <Footer>
        <span>
          {choice.value === null
            ? "nothing is ticked"
            : `${countText(count)} chosen; nothing is taken before the button`}
        </span>
        <Key keys={["a", "b"]} text="make it A, B" />
        <Key keys={["Space"]} text="take or leave" />
        <Key keys={["Ctrl", "Z"]} text="undo" />
      </Footer>
    </>
  );
}

function TakeBar() {
  const then = outcome.value;
  const own = nameOfSet(second.value);
  const what = !then?.count ? "" : then.count === total() ? `all ${then.count} values` : countText(then.count);
  return (
    <section class="pane bar2" aria-label="Compare">
      <SetChoice badge="a" label="First" value={first.value} side="first" />
      <span class="q">with</span>
      <SetChoice badge="b" label="Second" value={second.value} side="second" />
      <span class="q lead">take</span>
      <Segment
        label="Take"
        options={["whole", "by parameter", "by grid point"]}
        chosen={taking.value}
        choose={(option) => {
          taking.value = option as Taking;
        }}
      />
      <span class="grow" />
      {then !== null && then.count > 0 && <Then />}
      <button
        class="btn primary"
        id="take"
        disabled={!then?.count}
        title={then?.count ? "The other values stay as they are now" : reason()}
        onClick={() => void take()}
      >
        {then?.count ? `Take ${what} of ${own} into now` : reason()}
      </button>
    </section>
  );
}

const total = (): number => changes.value.reduce((sum, each) => sum + each.first.length, 0);

function reason(): string {
  if (choice.value === null) return "Tick what to take";
  return second.value === "now" ? "B is now" : `Now has these values of ${nameOfSet(second.value)}`;
}

function SetChoice(props: { badge: "a" | "b"; label: string; value: string; side: "first" | "second" }) {
  const keys = new Set([...history.value.map((row) => row.key).filter(Boolean), props.value]);
  return (
    <label class="row">
      <span class={`ab ${props.badge} on`}>{props.badge.toUpperCase()}</span>
      <select
        class="field small"
        aria-label={props.label}
        value={props.value}
        onChange={(event) => choose(props.side, event.currentTarget.value)}
      >
        {[...keys].map((key) => (
          <option value={key}>{nameOfSet(key)}</option>
        ))}
      </select>
    </label>
  );
}

/** The errors of each criterion now, and if the choice were taken. */
function Then() {
  const rows = outcome.value!.scores.filter((each) => each.use === "training");
  const all = outcome
    .value!.scores.map(
      (each) => `${each.use} ${each.criterion}: ${numberText(each.now)} → ${numberText(each.then)} ${each.unit}`,
    )
    .join("\n");
  return (
    <span class="then" id="then" title={all}>
      <span class="q">RMSE then</span>
      {rows.slice(0, 2).map((each) => (
        <span>
          {rows.length > 1 && <span class="q">{each.criterion} </span>}
          {numberText(each.now)} →{" "}
          <b class={worse(each.now, each.then) ? "bad" : better(each.now, each.then) ? "good" : "ink"}>
            {numberText(each.then)}
          </b>{" "}
          <span class="q">{each.unit}</span>
        </span>
      ))}
    </span>
  );
}

const worse = (now: number | null, then: number | null): boolean => now !== null && then !== null && then > now * 1.05;
const better = (now: number | null, then: number | null): boolean => now !== null && then !== null && then < now * 0.95;

/** Tables that make up for each other, and the set that belongs together. */
function Together() {
  const own: MovedTogether | null = outcome.value?.together ?? null;
  if (own === null) return <section class="pane sel none" />;
  const last = own.names.at(-1);
  const names = own.names.length > 1 ? `${own.names.slice(0, -1).join(", ")} and ${last}` : last;
  return (
    <section class="pane sel" role="alert">
      <div class="note bad" id="together">
        <Icon name="warning" />
        <span class="grow">
          <b>{own.names.length > 1 ? `${names} moved together.` : `A part of ${names} does not fit the rest.`}</b>{" "}
          {own.names.length > 1 ? `Without the others: ${numberText(own.alone)} ${own.unit}. ` : ""}
          {own.names.length > 1 ? "Together" : "The whole table"}: {numberText(own.together)} {own.unit}.
        </span>
        <button class="btn small" id="take-together" onClick={() => tickTables(own.names)}>
          Choose {own.names.length > 1 ? `all ${own.names.length}` : "the whole table"}, {countText(own.count)}
        </button>
        <button
          class="btn small"
          onClick={() => {
            taking.value = "whole";
          }}
        >
          Choose everything
        </button>
      </div>
    </section>
  );
}
