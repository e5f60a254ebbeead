// What is brushed, and what it can become: a view of these samples alone, a condition of the dataset, a weight.

import { useSignal } from "@preact/signals";
import { count, fixed, parseNumber, plain, signed, significant, unitText } from "../../drawing/numbers";
import { brushed } from "../../plot-data";
import {
  type Brush,
  brush,
  criterion,
  criterionNumber,
  datasetNumber,
  decimalsOfTime,
  isStretch,
  only,
  unitOfTime,
} from "../../plots";
import type { BrushedConditions, Toml } from "../../replies";
import { setKeys, valueAt } from "../../settings";
import { settled, table } from "../../store";
import { nameOf } from "../../strip-rows";

/** A selection of samples in words. */
export function describeBrush(own: Brush): string {
  if (isStretch(own)) {
    const places = Math.min(decimalsOfTime(own.end - own.begin), 1);
    return `${fixed(own.begin, places)} … ${fixed(own.end, places)} ${unitOfTime.value || "(points)"}`.trim();
  }
  if ("ranges" in own)
    return own.ranges
      .map((each) => `${nameOf(each.signal)} ${plain(each.least, 5)} … ${plain(each.greatest, 5)}`)
      .join(", ");
  const { parameter, value } = own.point;
  const axes = table.value?.name === parameter ? table.value.axes : [];
  const columns = axes[1]?.points.length ?? 1;
  const at = [Math.floor(value / columns), value % columns]
    .slice(0, axes.length)
    .map((k, axis) => plain(axes[axis]!.points[k] ?? NaN, 5));
  return `what informs ${parameter}${at.length ? ` at ${at.join(", ")}` : ""}`;
}

export function BrushBar() {
  const weighing = useSignal(false);
  const [own, numbers] = [brush.value, brushed.value];
  if (own === null || numbers === null) return null;
  const { conditions } = numbers;
  return (
    <div class="foot" role="region" aria-label="Brushed samples">
      <span class="lit cut words" title={describeBrush(own)}>
        <b>Brushed {describeBrush(own)}</b>
      </span>
      <span data-brushed={numbers.samples}>{count(numbers.samples)} samples</span>
      {!conditions.reason && Number.isFinite(numbers.rmse) && (
        <>
          <span class="q">RMSE</span>
          <span class="ink">
            {significant(numbers.rmse)} {unitText(criterion.value?.unit ?? "")}
          </span>
          <span class="q err">mean error</span>
          <span class="ink err">{signed(numbers.mean)}</span>
        </>
      )}
      {conditions.reason && (
        <span class="q cut reason" title={conditions.reason}>
          {conditions.reason}
        </span>
      )}
      <span class="right">
        {weighing.value ? (
          <Weight
            conditions={conditions}
            close={() => {
              weighing.value = false;
            }}
          />
        ) : (
          <>
            <button
              class="btn small"
              disabled={numbers.samples === 0}
              title="Show these samples alone in all plots; nothing is written"
              onClick={() => {
                only.value = own;
              }}
            >
              Only these
            </button>
            {!conditions.reason && (
              <Become
                conditions={conditions}
                weigh={() => {
                  weighing.value = true;
                }}
              />
            )}
          </>
        )}
        <button
          class="btn bare small"
          aria-label="Brush nothing"
          title="Brush nothing (Esc)"
          onClick={() => {
            brush.value = null;
          }}
        >
          ×
        </button>
      </span>
    </div>
  );
}

/** The buttons that write the brush to the project file. */
function Become({ conditions, weigh }: { conditions: BrushedConditions; weigh: () => void }) {
  return (
    <>
      <button
        class="btn small"
        title={`Score only these samples\n[[dataset]] where = "${conditions.where}"`}
        onClick={() => limit(conditions.where, "Only the brushed samples are scored")}
      >
        As where
      </button>
      <button
        class="btn small"
        disabled={!conditions.region}
        title={
          conditions.regionReason ||
          `Weight these samples in the criterion\n[[criterion]] regions: where = "${conditions.region}"`
        }
        onClick={weigh}
      >
        Weight…
      </button>
      <button
        class="btn small"
        title={`Do not score these samples\n[[dataset]] where = "${conditions.outside}"`}
        onClick={() => limit(conditions.outside, "The brushed samples are left out")}
      >
        Leave out
      </button>
    </>
  );
}

const limit = (condition: string, title: string): void =>
  void setKeys([[["dataset", settled.value.datasets[datasetNumber.value]!.number, "where"], condition]], title);

/** Asks for the weight of the brushed samples, in place. */
function Weight({ conditions, close }: { conditions: BrushedConditions; close: () => void }) {
  const text = useSignal("2");
  const weight = parseNumber(text.value);
  const valid = weight !== null && weight >= 0 && Number.isFinite(weight);
  const apply = () => {
    if (!valid) return;
    const path = ["criterion", criterionNumber.value + 1, "regions"];
    const before = valueAt(path);
    const regions: Toml[] = [...(Array.isArray(before) ? before : []), { where: conditions.region, weight: weight! }];
    void setKeys([[path, regions]], `${criterion.value?.node}: weight ${text.value.trim()} for the brushed samples`);
    close();
  };
  return (
    <span class="row">
      <span class="q">weight{settled.value.criteria.length > 1 ? ` in ${criterion.value?.node}` : ""}</span>
      <span
        class={`field small num ${valid ? "" : "bad"}`}
        style={{ width: "52px" }}
        title={
          "Factor on the loss of these samples, >= 0; 0 does not evaluate them. Typical: 2 to 10\n[[criterion]] regions"
        }
      >
        <input
          ref={(element) => element?.focus()}
          aria-label="Weight of the brushed samples"
          inputMode="decimal"
          value={text.value}
          onInput={(event) => {
            text.value = event.currentTarget.value;
          }}
          onKeyDown={(event) => {
            if (event.key === "Enter") apply();
            if (event.key === "Escape") {
              event.stopPropagation();
              close();
            }
          }}
        />
      </span>
      <button class="btn small" disabled={!valid} onClick={apply}>
        Set
      </button>
      <button class="btn bare small" onClick={close}>
        Cancel
      </button>
    </span>
  );
}
