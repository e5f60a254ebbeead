// What is optimised and how: criteria, limits, equalities, the sequence of steps, and the search.

import { useSignal } from "@preact/signals";
import { useLayoutEffect, useRef } from "preact/hooks";
import { ChoiceField, NumberField } from "../../fields";
import { EntryForm, focusSetting } from "../../instruments/entry-form";
import { EntryList } from "../../instruments/entry-list";
import { wanted } from "../../navigation";
import { keysOf } from "../../schema";
import { settings } from "../../settings";

const QUICK = ["starts", "seed", "continuation", "max_iterations", "method", "tolerance"];

export function OptimizationSettings() {
  return (
    <>
      <EntryList
        section="criterion"
        noun="criterion"
        title="Criteria"
        sub="what the fit minimises"
        empty="What shall the function reproduce? Name a node, and the channel that it follows."
        line={(k) => (
          <>
            <label class="quick">
              <span class="q">weight</span>
              <NumberField path={["criterion", k, "weight"]} label={`Weight of criterion ${k}`} width={44} />
            </label>
            <ChoiceField path={["criterion", k, "loss"]} label={`Loss of criterion ${k}`} width={76} />
          </>
        )}
      />
      <EntryList
        section="limit"
        noun="limit"
        title="Limits"
        oneOf={["min", "max"]}
        empty="No limits. A limit keeps a node within bounds at every training sample."
      />
      <EntryList
        section="equality"
        noun="equality"
        title="Equalities"
        empty="No equalities. An equality fixes a sum of values of parameters."
      />
      <div class="head mid">
        <h2>Search</h2>
      </div>
      <QuickFields />
      <Further section="optimizer" skip={QUICK} label="all settings" />
      <Further section="cluster" skip={[]} label="partitions and cluster" />
      <EntryList
        section="step"
        noun="step"
        title="Sequence"
        ordered
        empty="One search, all at once. Steps search one after the other."
      />
    </>
  );
}

function QuickFields() {
  const host = useRef<HTMLDivElement>(null);
  const name = wanted.value;
  useLayoutEffect(() => {
    if (name.startsWith("optimizer.") && focusSetting(host.current, name)) wanted.value = "";
  });
  return (
    <div class="opts" ref={host}>
      <label class="o">
        <span class="q">Starts</span>
        <NumberField path={["optimizer", "starts"]} label="Starts" />
      </label>
      <label class="o">
        <span class="q">Seed</span>
        <NumberField path={["optimizer", "seed"]} label="Seed" />
      </label>
      <label class="o">
        <span class="q">Continuation</span>
        <ChoiceField path={["optimizer", "continuation"]} label="Continuation" />
      </label>
      <label class="o">
        <span class="q">Iterations, at most</span>
        <NumberField path={["optimizer", "max_iterations"]} label="Iterations, at most" />
      </label>
      <label class="o">
        <span class="q">Method</span>
        <ChoiceField path={["optimizer", "method"]} label="Method" width={108} />
      </label>
      <label class="o">
        <span class="q">Tolerance</span>
        <NumberField path={["optimizer", "tolerance"]} label="Tolerance" />
      </label>
    </div>
  );
}

/** The keys of a section that have no field of their own above. */
export function Further({ section, skip, label }: { section: string; skip: string[]; label: string }) {
  const open = useSignal(false);
  const rest = keysOf(section).filter((key) => !skip.includes(key.name));
  const isWanted = rest.some((key) => wanted.value === `${section}.${key.name}`);
  const isSet = rest.some((key) => key.name in ((settings.value.settings[section] as object | undefined) ?? {}));
  const isOpen = open.value || isWanted || isSet;
  if (isWanted && !open.value) open.value = true;
  if (isOpen) return <EntryForm path={[section]} skip={skip} />;
  return (
    <button
      class="fold more"
      aria-expanded={false}
      onClick={() => {
        open.value = true;
      }}
    >
      › {label} ({rest.length})
    </button>
  );
}
