// The sample at the cursor: what the function reads there, its error, and the samples with the worst errors.

import { computed, effect } from "@preact/signals";
import { newest } from "../../connection";
import { MISSING, numberText, plain, signed, significant, unitText } from "../../drawing/numbers";
import { ErrorFacts, placeText, split, useSplit } from "../../instruments/error-split";
import { criterionNumber, cursor, datasetNumber } from "../../plots";
import type { WorstRow } from "../../replies";
import { scoped } from "../../scope";
import { request, revision, screen, settled, state } from "../../store";

const worst = scoped<{ samples: WorstRow[]; rmse: number | null }>({ samples: [], rmse: null });
const load = newest(async (given: { dataset: number; criterion: number }) => {
  const reply = await request("worst", given);
  if (reply !== null) worst.value = reply.head;
});
const asked = computed(() => `${datasetNumber.value} ${settled.value.criteria.length ? criterionNumber.value : -1}`);

effect(() => {
  void revision.value;
  const [dataset, criterion] = asked.value.split(" ").map(Number);
  if (screen.value === "function" && criterion! >= 0 && settled.value.datasets[dataset!] !== undefined)
    load({ dataset: dataset!, criterion: criterion! });
});

/** Move the cursor by samples. */
export async function step(samples: number): Promise<void> {
  const own = split.peek();
  if (own === null) return;
  const reply = await request("split", {
    dataset: own.dataset,
    criterion: own.criterion,
    position: own.position,
    step: samples,
  });
  if (reply !== null) cursor.value = reply.head.position;
}

export function CursorPane() {
  const own = useSplit();
  const timed = settled.value.datasets[datasetNumber.value]?.timed;
  const [first] = worst.value.samples;
  return (
    <section class="pane io" aria-label="At the cursor">
      <div class="head">
        <h2>At the cursor</h2>
        <span class="sub">{own && placeText(own)}</span>
        <span class="right">
          <select
            class="field small"
            aria-label="Dataset"
            value={datasetNumber.value}
            onChange={(event) => {
              datasetNumber.value = Number(event.currentTarget.value);
              cursor.value = null;
            }}
          >
            {state.value.datasets.map((data, k) => (
              <option value={k}>{data.name}</option>
            ))}
          </select>
          <button
            class="btn small"
            aria-label="Previous sample"
            title="Previous sample (Alt ↑)"
            disabled={own === null}
            onClick={() => step(-1)}
          >
            ‹
          </button>
          <button
            class="btn small"
            aria-label="Next sample"
            title="Next sample (Alt ↓)"
            disabled={own === null}
            onClick={() => step(1)}
          >
            ›
          </button>
          <button
            class="btn small"
            disabled={!first}
            title="The sample with the largest error"
            onClick={() => {
              cursor.value = first!.position;
            }}
          >
            Worst
          </button>
        </span>
      </div>
      {own === null ? (
        <p class="pad q">Add recordings on Data and a criterion: then the values at one sample are shown here.</p>
      ) : (
        <div class="iog">
          <table class="list">
            <thead>
              <tr>
                <th>reads</th>
                <th>channel</th>
                <th class="num">value</th>
                <th>
                  <span class="unseen">unit</span>
                </th>
              </tr>
            </thead>
            <tbody>
              {own.inputs.map((each) => (
                <tr key={each.name}>
                  <td class="cut">
                    <b>{each.name}</b>
                  </td>
                  <td class="mono cut">{each.channel}</td>
                  <td class="num ink">{numberText(each.value)}</td>
                  <td class="q">{unitText(each.unit)}</td>
                </tr>
              ))}
            </tbody>
          </table>
          <ErrorFacts own={own} />
        </div>
      )}
      <div class="head mid">
        <h2>Worst {timed ? "samples" : "points"}</h2>
        <span class="sub">
          {first?.error && worst.value.rmse
            ? `the first has ${significant(Math.abs(first.error) / worst.value.rmse, 2)} times the RMSE; choose one and everything here shows it`
            : "choose one and everything here shows it"}
        </span>
      </div>
      <table class="list worst" data-worst>
        <thead>
          <tr>
            <th class="num">{timed ? "time" : "point"}</th>
            {own?.inputs.slice(0, 4).map((each) => (
              <th class="num">{each.name}</th>
            ))}
            <th class="num">measured</th>
            <th class="num">calculated</th>
            <th class="num">error</th>
          </tr>
        </thead>
        <tbody>
          {worst.value.samples.map((row) => (
            <tr
              key={row.sample}
              class={row.sample === own?.sample ? "on" : ""}
              tabIndex={0}
              onClick={() => {
                cursor.value = row.position;
              }}
              onKeyDown={(event) => {
                if (event.key === "Enter") cursor.value = row.position;
              }}
            >
              <td class="num">{timed ? plain(row.position, 7) : row.sample + 1}</td>
              {row.inputs.slice(0, 4).map((value) => (
                <td class="num">{numberText(value)}</td>
              ))}
              <td class="num ink">{numberText(row.measured)}</td>
              <td class="num ink">
                {row.measured === null || row.error === null ? MISSING : significant(row.measured + row.error)}
              </td>
              <td class="num ink">{row.error === null ? MISSING : signed(row.error, 4)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}
