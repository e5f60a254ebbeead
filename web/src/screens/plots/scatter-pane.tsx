// Calculated over measured values, or any signal over any other.

import { unitText } from "../../drawing/numbers";
import { ScatterPlot } from "../../instruments/scatter";
import { pair, points, scatter } from "../../plot-data";
import { criterion, criterionNumber, dataset, keyOf, only } from "../../plots";
import type { SignalName } from "../../replies";
import { settled } from "../../store";
import { inputs, nameOf, rows, titleOf, unitOf } from "../../strip-rows";

export function ScatterPane() {
  const own = pair.value;
  return (
    <section class="pane sc" aria-label="Scatter plot">
      <div class="head">
        {own === null ? (
          <h2>Calculated over measured</h2>
        ) : (
          <>
            <Choice
              label="Signal upwards"
              own={own[1]}
              choose={(next) => {
                pair.value = [own[0], next];
              }}
            />
            <span class="q">over</span>
            <Choice
              label="Signal to the right"
              own={own[0]}
              choose={(next) => {
                pair.value = [next, own[1]];
              }}
            />
          </>
        )}
        <span class="right">
          {own === null && <span class="q">{unitText(criterion.value?.unit ?? "")}</span>}
          <button
            class="btn small"
            aria-pressed={own !== null}
            title="Any signal over any other"
            onClick={() => {
              pair.value =
                own === null
                  ? [inputs.value[0] ?? measured(), { kind: "error", name: String(criterionNumber.value) }]
                  : null;
            }}
          >
            {own === null ? "x, y" : "Fit"}
          </button>
        </span>
      </div>
      {own === null ? <Fit /> : <Pair own={own} />}
    </section>
  );
}

const measured = (): SignalName => ({ kind: "target", name: String(criterionNumber.value) });

function Fit() {
  const data = scatter.value;
  if (data === null || criterion.value === undefined)
    return (
      <p class="pad q">
        {criterion.value ? "" : "Add a criterion: a node of the function and the channel that it shall follow."}
      </p>
    );
  if (!data.measured.some(Number.isFinite))
    return (
      <p class="pad q">
        {only.value
          ? "None of the shown samples is scored."
          : `${dataset.value?.name} has no scored sample of ${criterion.value.node}.`}
        {settled.value.criteria.length > 1 && " Choose another criterion above."}
      </p>
    );
  const clouds = [
    { y: data.start, colour: "before" },
    { y: data.now, colour: "model" },
  ];
  return (
    <ScatterPlot
      label="Calculated over measured"
      signals={[measured(), { kind: "node", name: criterion.value.node }]}
      title="measured"
      x={data.measured}
      clouds={clouds}
      lit={data.lit}
      position={data.position}
      begin={dataset.value?.begin ?? 0}
      diagonal
    />
  );
}

function Pair({ own }: { own: [SignalName, SignalName] }) {
  const data = points.value;
  const [x, y] = own.map((each) => data?.values[data.signals.findIndex((other) => keyOf(other) === keyOf(each))]);
  if (data === null || x === undefined || y === undefined) return <p class="pad q" />;
  return (
    <ScatterPlot
      label={`${nameOf(own[1])} over ${nameOf(own[0])}`}
      signals={own}
      title={titleOf(own[0])}
      x={x}
      clouds={[{ y, colour: own[1].kind.includes("error") ? "error" : "model" }]}
      lit={data.lit}
      position={data.position}
      begin={data.begin}
    />
  );
}

/** All signals that are drawn, and those of the function. */
function choices(own: SignalName): SignalName[] {
  const { criteria, nodes } = settled.value;
  const all: SignalName[] = [
    own,
    ...inputs.value,
    ...criteria.flatMap<SignalName>((_, i) => [
      { kind: "error", name: String(i) },
      { kind: "target", name: String(i) },
    ]),
    ...rows.value.flatMap((row) => row.lines.map((each) => each.signal)),
    ...nodes.slice(0, 200).map<SignalName>((each) => ({ kind: "node", name: each.name })),
  ];
  return [...new Map(all.map((each) => [keyOf(each), each])).values()];
}

function Choice({ label, own, choose }: { label: string; own: SignalName; choose: (next: SignalName) => void }) {
  const all = choices(own);
  return (
    <select
      class="field small grow"
      aria-label={label}
      title={`${label}: ${nameOf(own)} ${unitOf(own)}\nSignals that are drawn as strips can be chosen here, too.`}
      value={keyOf(own)}
      onChange={(event) => choose(all.find((each) => keyOf(each) === event.currentTarget.value)!)}
    >
      {all.map((each) => (
        <option value={keyOf(each)}>{nameOf(each)}</option>
      ))}
    </select>
  );
}
