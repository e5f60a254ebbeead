// Which criterion's errors are shown, if there are several.

import { chooseCriterion, criterionNumber } from "../plots";
import { settled } from "../store";

export function CriterionChoice() {
  const all = settled.value.criteria;
  if (all.length < 2) return null;
  return (
    <select
      class="field small"
      aria-label="Criterion"
      title="The criterion whose errors are shown"
      value={criterionNumber.value}
      onChange={(event) => chooseCriterion(Number(event.currentTarget.value))}
    >
      {all.map((each, k) => (
        <option value={k}>{each.node}</option>
      ))}
    </select>
  );
}
