// At the lower right: the grid points that brushed samples pass, the sample at the cursor, or the measured range.

import { fixed, MISSING, numberText, signed, significant } from "../../drawing/numbers";
import { ErrorSplit, placeText, split } from "../../instruments/error-split";
import { brushed, rangeRows } from "../../plot-data";
import { cursor, keyOf, part, range, unitOfTime } from "../../plots";
import { open, openName, state } from "../../store";
import { nameOf, unitOf } from "../../strip-rows";
import { PassedMap } from "./passed-map";

const PARTS = { point: "Points", sample: "Sample", range: "Range" } as const;

export function PartTabs() {
  return (
    <span class="seg tight" role="group" aria-label="Pane">
      {(Object.keys(PARTS) as (keyof typeof PARTS)[]).map((name) => (
        <button
          aria-pressed={part.value === name}
          onClick={() => {
            part.value = name;
          }}
        >
          {PARTS[name]}
        </button>
      ))}
    </span>
  );
}

export function PointPane({ tabs }: { tabs: boolean }) {
  const weights = brushed.value?.weights[openName.value];
  const tables = state.value.parameters.filter((each) => each.shape.length > 0 && each.kind !== "scalar");
  return (
    <section class="pane mp" aria-label="Grid points">
      <div class="head">
        {tabs ? <PartTabs /> : <h2>Grid points</h2>}
        <select
          class="field small grow"
          aria-label="Table"
          title="The table whose grid points are shown; click one to light up its samples"
          value={openName.value}
          onChange={(event) => open(event.currentTarget.value)}
        >
          {tables.map((each) => (
            <option value={each.name}>{each.name}</option>
          ))}
        </select>
      </div>
      <PassedMap weights={weights} />
    </section>
  );
}

export function SamplePane({ tabs }: { tabs: boolean }) {
  return (
    <section class="pane sample" aria-label="Sample">
      <div class="head">
        {tabs ? <PartTabs /> : <h2>Sample</h2>}
        <span class="sub right">{cursor.value !== null && split.value !== null ? placeText(split.value) : ""}</span>
      </div>
      {cursor.value === null && state.value.criteria.length > 0 ? (
        <p class="pad q">
          Click a sample in a strip or a scatter plot: its error is shown here, the value of each node, and the change
          of each table that would take the error away. <kbd>←</kbd> <kbd>→</kbd> go on from there.
        </p>
      ) : (
        <div class="scroll">
          <ErrorSplit nodes />
        </div>
      )}
    </section>
  );
}

export function RangePane({ tabs }: { tabs: boolean }) {
  const [own, list] = [range.value, rangeRows.value];
  const wide = own === null ? 0 : own.end - own.begin;
  return (
    <section class="pane rg" aria-label="Range">
      <div class="head">
        {tabs ? <PartTabs /> : <h2>Range</h2>}
        <span class="sub right" title={own ? `${fixed(own.begin, 3)} … ${fixed(own.end, 3)}` : ""}>
          {own === null ? (
            ""
          ) : unitOfTime.value ? (
            <>
              Δt{" "}
              <b class="ink" id="range-length">
                {significant(wide, 5)}
              </b>{" "}
              s · {significant(1 / wide, 3)} Hz
            </>
          ) : (
            <>
              <b class="ink" id="range-length">
                {significant(wide, 5)}
              </b>{" "}
              points
            </>
          )}
        </span>
      </div>
      {own === null || list === null ? (
        <p class="pad q">
          Choose Range (<kbd>R</kbd>) and drag over the strips: here are the length, and for each signal the difference
          between both ends, and its statistics.
        </p>
      ) : (
        <div class="scroll">
          <table class="list">
            <thead>
              <tr>
                <th>signal</th>
                <th class="num" title="Difference: value at the end minus value at the begin">
                  Δ
                </th>
                <th class="num">min</th>
                <th class="num">mean</th>
                <th class="num">max</th>
                <th class="num">rms</th>
              </tr>
            </thead>
            <tbody>
              {list.map((row) => (
                <tr
                  key={keyOf(row.signal)}
                  title={`${nameOf(row.signal)} ${unitOf(row.signal)}\nbegin ${significant(row.begin, 5)}, end ${significant(row.end, 5)}\n${row.statistics.samples} samples`}
                >
                  <td class="cut name">
                    <i style={{ background: `var(--${row.colour})` }} />
                    {row.label}
                  </td>
                  <td class="num ink">
                    {Number.isFinite(row.end - row.begin) ? signed(row.end - row.begin, 4) : MISSING}
                  </td>
                  <td class="num">{numberText(row.statistics.least)}</td>
                  <td class="num ink">{numberText(row.statistics.mean)}</td>
                  <td class="num">{numberText(row.statistics.greatest)}</td>
                  <td class="num">{numberText(row.statistics.rms)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
    </section>
  );
}
