// What the data of the last run cannot determine: each row with its remedies, which change the project file.

import { tried, trust } from "../../comparison";
import { settle } from "../../design";
import { significant } from "../../drawing/numbers";
import { Icon } from "../../icons";
import type { RemedyRow, UndeterminedDirection } from "../../replies";
import { describePath, setKeys } from "../../settings";
import { state } from "../../store";

/** Smoothness and limits may determine what the data leave open. */
const determined = (freedom: number | null | undefined, values: number): string =>
  freedom != null && freedom < 0.99 * values
    ? "Data, smoothness and limits together determine all values."
    : "The data determine all values.";

export function TrustPane() {
  const { directions, coupled, sentence, advice, remark, remedies, holdings, noise, freedom, values } = trust.value;
  const ran = state.value.runs.length > 0;
  const open = directions.length + Number(Boolean(sentence));
  return (
    <section class="pane dr" id="trust">
      <div class="head">
        <h2>Not determined</h2>
        <span class="sub">
          {directions.length
            ? `${directions.length} direction${directions.length > 1 ? "s" : ""}, least known first`
            : ""}
        </span>
        {freedom !== null && freedom !== undefined && (
          <span
            class="right q"
            title="Degrees of freedom that the fit used: the effective number of values that the data determine"
          >
            {significant(freedom, 3)} of {values} by the data alone
          </span>
        )}
      </div>
      {!ran && (
        <p class="pad q">
          After a run this lists changes of the values that the data hardly notice, each with a remedy.
        </p>
      )}
      {ran && open === 0 && <p class="pad q">{remark || determined(freedom, values)}</p>}
      {open > 0 && remark && <p class="note warn">{remark}</p>}
      {sentence && (
        <div class={`di ${remedies.length ? "on" : ""}`}>
          <b class="bad">{remedies.length ? "open" : "–"}</b>
          <div class="grow">
            <p>{sentence}</p>
            <p class="q">{advice}</p>
            <Remedies own={remedies} first number={0} />
          </div>
        </div>
      )}
      {directions.map((each, k) => (
        <Row own={each} number={k + 1} />
      ))}
      {coupled.map((text, k) => (
        <div class="di">
          <b class="good">coupled</b>
          <div class="grow">
            <p>{text}</p>
            <p class="remedies">
              <MeasureNext number={directions.length + k + 1} />
            </p>
          </div>
        </div>
      ))}
      {holdings.map((text) => (
        <div class="di">
          <b class="q">limit</b>
          <div class="grow">
            <p>{text}</p>
          </div>
        </div>
      ))}
      {noise.length > 0 && (
        <p class="pad q">
          Noise:{" "}
          {noise
            .map((each) => `${each.criterion} ${each.value === null ? "unknown" : significant(each.value, 4)}`)
            .join(", ")}
        </p>
      )}
    </section>
  );
}

/** The way to the points or minutes that would settle a direction; 0 for what nothing determines. */
function MeasureNext({ number }: { number: number }) {
  return (
    <button
      class="btn small"
      data-settle={number}
      title="What to measure next, so that the data determine this"
      onClick={(event) => {
        event.stopPropagation();
        settle(number);
      }}
    >
      Measure next
    </button>
  );
}

function Row({ own, number }: { own: UndeterminedDirection; number: number }) {
  const size = own.deviation;
  return (
    <div
      class={`di ${own.remedies.some((each) => each.title === tried.value) ? "on" : ""}`}
      onClick={() => {
        tried.value = own.remedies.find((each) => each.kind === "pin")?.title ?? "";
      }}
    >
      <b
        class={size === null || size > 20 ? "bad" : size > 5 ? "warn" : "good"}
        title="Standard deviation, as a multiple of the change that the sentence describes"
      >
        {size === null ? "open" : `± ${significant(size, 2)}`}
      </b>
      <div class="grow">
        <p>{own.sentence}</p>
        <p class="q">{own.remedy}</p>
        <Remedies own={own.remedies} number={number} />
      </div>
    </div>
  );
}

/** A button for each remedy; one that the project file has already says so. */
function Remedies({ own, first = false, number }: { own: RemedyRow[]; first?: boolean; number: number }) {
  return (
    <p class="remedies">
      {own.map((each, k) =>
        each.applied ? (
          <span class="good" data-remedy={each.kind}>
            <Icon name="done" /> applied: {each.title}
          </span>
        ) : (
          <button
            class="btn small"
            data-remedy={each.kind}
            id={first && k === 0 ? "pin" : undefined}
            title={each.changes.map(([path, value]) => `${describePath(path)} = ${JSON.stringify(value)}`).join("\n")}
            onFocus={() => {
              tried.value = each.title;
            }}
            onMouseEnter={() => {
              if (each.kind === "pin") tried.value = each.title;
            }}
            onClick={() => setKeys(each.changes, each.title)}
          >
            {each.title}
          </button>
        ),
      )}
      <MeasureNext number={number} />
    </p>
  );
}
