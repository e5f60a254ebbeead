// The proposals, the errors of the chosen one on each part of the data that was held out, and the verdict.

import { counted, numberText, plain, signed, significant, unitText } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import {
  choose,
  chosen,
  look,
  looking,
  type Order,
  order,
  ordered,
  outcome,
  place,
  proposal,
  terms,
} from "../../missing";
import type { BeforeAfter, FoundTerms, TermRow } from "../../replies";
import { run } from "../../runs";
import { blocking, state } from "../../store";

export function ProposalsPane() {
  const own = outcome.value;
  return (
    <section class="pane" aria-label="Proposals">
      <div class="head">
        <h2>What is missing?</h2>
        {own?.old ? (
          <span class="sub warn" id="terms-old">
            older than the values
          </span>
        ) : (
          <span class={`sub ${looking.value ? "acc" : ""}`}>
            {looking.value
              ? state.value.terms.text
              : `for ${[...new Set(state.value.criteria.map((each) => each.node))].join(" and ")}`}
          </span>
        )}
        <span class="right">
          {own !== null && own.proposals.length > 1 && (
            <Segment
              label="Order"
              options={["held out", "training", "few values"]}
              chosen={order.value}
              choose={(option) => {
                order.value = option as Order;
              }}
            />
          )}
        </span>
      </div>
      {state.value.terms.state === "failed" && (
        <p class="note bad" id="search-failed">
          <Icon name="warning" />
          <span class="grow">{state.value.terms.text}</span>
        </p>
      )}
      {own?.remarks.map((text) => (
        <Remark text={text} own={own} />
      ))}
      {own === null && <Empty />}
      {ordered.value.map((at, k) => (
        <Proposal own={own!.proposals[at]!} at={at} rank={k + 1} unit={own!.unit} />
      ))}
      {own?.rejected.map((text) => (
        <div class="pp rowy" data-rejected>
          <span class="no">–</span>
          <p class="q">{text}</p>
        </div>
      ))}
    </section>
  );
}

/** What a search says of the values; they are fitted by a run. */
function Remark({ text, own }: { text: string; own: FoundTerms }) {
  return (
    <div class="note warn">
      <Icon name="warning" />
      <span class="grow">{text}</span>
      {!own.old && (
        <button
          class="btn small"
          disabled={blocking.value !== null}
          title="Fit the values of the function (F5)"
          onClick={run}
        >
          Run first
        </button>
      )}
    </div>
  );
}

function Empty() {
  const own = terms.value;
  const usable = own?.channels.filter((each) => each.reason === "").length ?? 0;
  return (
    <div class="pad" id="nothing-asked">
      <p>
        Looks for a term that the formula lacks, at {counted(own?.nodes.length ?? 0, "node")} and over{" "}
        {counted(usable, "channel")}. Proposals are judged on data that their fit has not seen; the formula changes with
        Apply only.
      </p>
      {state.value.runs.length === 0 && (
        <p class="q">The values are fitted first, without a change of those in the project.</p>
      )}
    </div>
  );
}

function Proposal({ own, at, rank, unit }: { own: TermRow; at: number; rank: number; unit: string }) {
  const on = at === chosen.value;
  return (
    <div
      class={`pp rowy ${on ? "on" : ""}`}
      role="button"
      tabIndex={0}
      aria-pressed={on}
      data-proposal={at}
      onClick={() => {
        if (!on) choose(at);
      }}
      onKeyDown={(event) => {
        if (event.target === event.currentTarget && (event.key === "Enter" || event.key === " ")) {
          choose(at);
          event.preventDefault();
        }
      }}
    >
      <span class="no">{rank}</span>
      <div>
        <h3>{own.change}</h3>
        <p>{facts(own)}</p>
        {own.places.length > 0 && <EqualPlaces own={own} at={at} />}
      </div>
      <div class="g">
        <Change name="training" own={own.training} unit={unit} kind="ink" />
        <Change name="held out" own={own.heldOut} unit={unit} kind="good" />
        {own.test !== null && <Change name="test" own={own.test} unit={unit} kind="ink" />}
        <span class="q">
          explains <span class="ink">{numberText(own.explains)}</span> {unitText(unit)}
        </span>
      </div>
    </div>
  );
}

function facts(own: TermRow): string {
  const values = own.values === 0 ? "no value" : counted(own.values, "value");
  const better = `better in ${own.better} of ${own.parts}`;
  const unit = unitText(terms.value?.channels.find((each) => each.name === own.channel)?.unit ?? "");
  const range = own.ends.map(([at, value]) => `${significant(value, 3)} at ${plain(at)} ${unit}`.trim()).join(", ");
  return [values, range, better, own.location].filter(Boolean).join(" · ");
}

function Change({ name, own, unit, kind }: { name: string; own: BeforeAfter; unit: string; kind: string }) {
  const worse = own.before !== null && own.after !== null && own.after > own.before;
  return (
    <span class="row">
      <span class="q">
        {name} {numberText(own.before)} →
      </span>{" "}
      <b class={worse ? "bad" : kind}>{numberText(own.after)}</b> <span class="q">{unitText(unit)}</span>
    </span>
  );
}

/** Places that the data cannot tell apart; a click chooses one, the numbers stay. */
function EqualPlaces({ own, at }: { own: TermRow; at: number }) {
  const others = [...new Set(own.places.map((each) => each.node))].filter((name) => name !== own.node);
  const shown = at === chosen.value;
  return (
    <div class="eqv">
      {others.length > 0 ? (
        <>
          The data cannot tell <b class="ink">{[own.node, ...others].join(", ")}</b> apart: choose by physics.
        </>
      ) : (
        "Adding and scaling explain the same here."
      )}
      {shown && (
        <span class="equal">
          <button class="chip" aria-pressed={place.value === null} onClick={() => choose(at)}>
            {own.change}
          </button>
          {own.places.map((each) => (
            <button
              class="chip"
              data-place={each.number}
              aria-pressed={place.value === each.number}
              onClick={(event) => {
                event.stopPropagation();
                place.value = each.number;
              }}
            >
              {each.change}
            </button>
          ))}
        </span>
      )}
    </div>
  );
}

export function HeldOutPane() {
  const own = proposal.value;
  if (own === null) return null;
  const gains = own.heldOutParts.map(({ rmse }) => (rmse.after ?? 0) - (rmse.before ?? 0));
  const most = Math.max(...gains.map(Math.abs), 1e-300);
  return (
    <section class="pane folds" aria-label="Held out">
      <div class="head">
        <h2>Held out, part by part</h2>
        <span class="sub">each part was fitted by the others</span>
      </div>
      <table class="list fold" id="held-out">
        <thead>
          <tr>
            <th>{own.heldName}</th>
            <th class="num">samples</th>
            <th class="num">without</th>
            <th class="num">with</th>
            <th class="num">gain</th>
            <th />
          </tr>
        </thead>
        <tbody>
          {own.heldOutParts.map((part, k) => (
            <tr>
              <td class="cut" title={part.name}>
                <b>{part.name}</b>
              </td>
              <td class="num">{part.samples}</td>
              <td class="num">{numberText(part.rmse.before)}</td>
              <td class="num ink">{numberText(part.rmse.after)}</td>
              <td class={`num ${gains[k]! < 0 ? "good" : "bad"}`}>{signed(gains[k]!, 2)}</td>
              <td style={{ width: "130px" }}>
                <span
                  class="bar"
                  style={{
                    width: `${Math.max(2, (100 * Math.abs(gains[k]!)) / most)}px`,
                    background: `var(--${gains[k]! < 0 ? "good" : "error"})`,
                  }}
                />
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}

/** What the search says of all that it did not propose. */
export function Verdict() {
  const own = outcome.value;
  if (own === null) return null;
  if (own.stopped !== null) {
    const [fitted, all] = own.stopped;
    if (looking.value) return null;
    return (
      <div class="note warn bot" id="verdict">
        <Icon name="warning" />
        <span class="grow">
          Stopped: {fitted} of {all} candidates were fitted. These proposals are not compared with each other: some may
          explain the same.
        </span>
        <button class="btn small" onClick={() => void look()}>
          Look again
        </button>
      </div>
    );
  }
  const kind = own.status === "failed" ? "bad" : own.old ? "" : "good";
  return (
    <div class={`note ${kind} bot`} id="verdict">
      <Icon name={kind === "good" ? "done" : "warning"} />
      <span class="grow">
        {own.status === "found" && <b>Nothing else is explained by these channels. </b>}
        {own.message}
        {own.excluded.length > 0 && (
          <details id="excluded">
            <summary>{counted(own.excluded.length, "channel")} took no part</summary>
            {own.excluded.map(([name, reason]) => (
              <p>
                <b>{name}</b>: {reason}
              </p>
            ))}
          </details>
        )}
      </span>
    </div>
  );
}
