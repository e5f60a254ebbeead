// The question: what shall be settled, what will be recorded, and within which limits; the button that answers it.

import {
  candidates,
  chooseRecorded,
  chooseTable,
  computing,
  counts,
  deviationText,
  direction,
  flipName,
  names,
  outcome,
  propose,
  type Recorded,
  recorded,
  table,
} from "../../design";
import { MISSING, significant, unitText } from "../../drawing/numbers";
import { NumberField, Segment } from "../../fields";
import { Icon } from "../../icons";
import { LineInput, NumberInput } from "../../inputs";
import type { DesignParameter, Designs, DesignTableRow } from "../../replies";
import { blocking, failure, request, state } from "../../store";
import { Further } from "../optimization/settings";

export function AskPane({ own }: { own: Designs }) {
  return (
    <section class="pane left ask" aria-label="What shall be settled">
      <div class="head">
        <h2>What shall be settled</h2>
      </div>
      <div class="look">
        <div class="grp" role="group" aria-label="Parameters">
          {own.parameters.map((each) => (
            <ParameterLine own={each} row={outcome.value?.tables.find((row) => row.name === each.name)} />
          ))}
          {own.parameters.length === 0 && <p class="q">No free values yet: points fill the ranges below.</p>}
        </div>
        <Recording own={own} />
        <div class="grp limits">
          <h3>limits, use and bench</h3>
          <Further section="design" skip={[]} label="ranges, conditions, use, bench" />
        </div>
        <Facts />
      </div>
      <Foot />
    </section>
  );
}

/** A parameter; a click shows it, a tick lets points determine it. */
function ParameterLine({ own, row }: { own: DesignParameter; row: DesignTableRow | undefined }) {
  const isPoints = recorded.value === "points";
  const facts = own.withoutData ? `${own.withoutData} without data` : row ? `± ${deviationText(row.median[0])}` : "";
  return (
    <div class={`tk ${table.value?.name === own.name ? "on" : ""}`}>
      {isPoints && (
        <input
          type="checkbox"
          aria-label={`Determine ${own.name}`}
          title="Points for this parameter; none is ticked for the whole function"
          data-determine={own.name}
          checked={names.value.has(own.name)}
          onChange={() => flipName(own.name)}
        />
      )}
      <button class="link plain cut" data-table={own.name} title={own.name} onClick={() => chooseTable(own.name)}>
        {own.name}
      </button>
      <span class="n">{facts}</span>
    </div>
  );
}

function Recording({ own }: { own: Designs }) {
  const kind = recorded.value;
  return (
    <div class="grp" role="group" aria-label="What will be recorded">
      <h3>what will be recorded</h3>
      <div class="kv">
        <span>as</span>
        <div>
          <Segment
            label="As"
            options={["drive", "points", "drop"]}
            chosen={kind}
            choose={(option) => chooseRecorded(option as Recorded)}
          />
        </div>
        <span>{{ drive: "segments", points: "points", drop: "keep" }[kind]}</span>
        <div>
          <Count kind={kind} />
          {kind === "drive" && (
            <>
              <span class="q">of</span>
              <NumberField path={["design", "length"]} label="Length of a segment" width={54} />
            </>
          )}
        </div>
        {kind !== "drop" && (
          <>
            <span>from</span>
            <div title="Recordings, points or time tables to choose from, or patterns, separated by commas">
              <span class="field small" style={{ width: "100%" }}>
                <LineInput
                  label="From"
                  holds="recording"
                  placeholder={kind === "drive" ? "old/*.mf4, or manoeuvres" : "the ranges"}
                  text={candidates.value}
                  enter={(text) => {
                    candidates.value = text;
                  }}
                />
              </span>
            </div>
          </>
        )}
        {kind === "points" && own.directions.length > 0 && (
          <>
            <span>settle</span>
            <div>
              <select
                class="field small"
                aria-label="Direction"
                value={String(direction.value)}
                title={own.directions[direction.value - 1] ?? ""}
                onChange={(event) => {
                  direction.value = Number(event.currentTarget.value);
                  if (direction.value > 0) names.value = new Set();
                }}
              >
                <option value="0">all, or what is ticked</option>
                {own.directions.map((text, k) => (
                  <option value={String(k + 1)}>
                    {k + 1}: {text}
                  </option>
                ))}
              </select>
            </div>
          </>
        )}
      </div>
      {kind === "drop" && <p class="q small">Recordings of the training data that add nothing.</p>}
      {kind === "points" && own.memory && (
        <p class="warn small">
          The function remembers what was before: points need `settle` in their dataset; a drive does not.
        </p>
      )}
    </div>
  );
}

function Count({ kind }: { kind: Recorded }) {
  return (
    <span class="field small num" style={{ width: "50px" }}>
      <NumberInput
        label={{ drive: "Segments", points: "Points", drop: "Keep" }[kind]}
        placeholder={{ drive: "15", points: "20", drop: "auto" }[kind]}
        own={counts[kind].value ?? undefined}
        enter={(value) => {
          if (value === null) counts[kind].value = null;
          else if (typeof value === "number" && Number.isInteger(value) && value >= 1) counts[kind].value = value;
          else failure.value = `A number must be an integer >= 1, got '${value}'`;
        }}
      />
    </span>
  );
}

function Facts() {
  const [own, row] = [outcome.value, table.value];
  if (own === null) return null;
  const unit = unitText(row?.unit ?? "");
  return (
    <div class="grp">
      <dl class="facts" id="design-facts">
        {row !== null && (
          <>
            <dt>median</dt>
            <dd>
              {deviationText(row.median[0])} → <b>{deviationText(row.median[1])}</b> <u>{unit}</u>
            </dd>
            <dt>greatest</dt>
            <dd>
              {deviationText(row.greatest[0])} → <b>{deviationText(row.greatest[1])}</b> <u>{unit}</u>
            </dd>
          </>
        )}
        {own.factor !== null && (
          <>
            <dt>variance in use</dt>
            <dd>
              100 → <b>{significant(100 * own.factor, 3)}</b> <u>%</u>
            </dd>
          </>
        )}
        {own.duration > 0 && (
          <>
            <dt>{own.segments.length ? "driving" : "bench"}</dt>
            <dd>
              <b>{significant(own.duration / 60, 3)}</b> <u>min</u>
            </dd>
          </>
        )}
      </dl>
    </div>
  );
}

function Foot() {
  const { text, state: own } = state.value.design;
  const again = outcome.value !== null;
  if (computing.value)
    return (
      <div class="frow g busy">
        <button
          class="btn stop"
          id="stop-design"
          title="The list before stays (Esc)"
          onClick={() => request("stop-design")}
        >
          <Icon name="stop" />
          Stop
        </button>
        <span class="grow">
          <span class="acc cut" title={text}>
            {text || MISSING}
          </span>
          <progress aria-label="Progress" />
        </span>
      </div>
    );
  const reason = state.value.parameters.length > 0 ? (blocking.value?.text ?? "") : "";
  return (
    <div class="frow g">
      <button
        class="btn primary"
        id="propose"
        disabled={reason !== ""}
        title={reason || "Fit the function, and choose what determines most; nothing is changed (p)"}
        onClick={() => void propose()}
      >
        {again ? "Propose again" : "Propose"}
      </button>
      <span class={`cut ${own === "failed" ? "bad" : "q"}`} title={text}>
        {own === "failed" ? text : again ? `${outcome.value!.seconds.toFixed(1)} s` : ""}
      </span>
    </div>
  );
}
