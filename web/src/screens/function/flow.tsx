// The signal flow of formula text: what each node reads, with the values at the cursor.

import { computed, signal } from "@preact/signals";
import { numberText } from "../../drawing/numbers";
import { flow, loadFlowIf } from "../../function-flow";
import { split } from "../../instruments/error-split";
import { type Edge, edgesOf, flowLayout, GAP, HEIGHT, WIDTH, wire } from "../../instruments/flow-layout";
import { screen } from "../../store";
import { isFileFunction } from "./file-source";
import { chosen, esdl, simulink } from "./source";

const pageWidth = signal(innerWidth);
addEventListener("resize", () => {
  pageWidth.value = innerWidth;
});

/** The number of columns for which the pane has room. */
const room = computed(() => Math.max(3, Math.floor((0.45 * (pageWidth.value - 136) - 20 + GAP) / (WIDTH + GAP))));

loadFlowIf(() => screen.value === "function" && !simulink.value && !esdl.value && !isFileFunction.value);

const layout = computed(() => (flow.value === null ? null : flowLayout(flow.value, chosen.value, room.value)));

export function SignalFlow() {
  const own = layout.value;
  if (own === null) return <p class="pad q">The nodes of the function and what they read are drawn here.</p>;
  const values = new Map([
    ...(split.value?.nodes ?? []).map((each) => [each.name, each.now] as const),
    ...(split.value?.inputs ?? []).map((each) => [each.name, each.value] as const),
  ]);
  const boxes = [...own.boxes.values()];
  const edges = edgesOf(own);
  const hot = (edge: Edge) => edge.from.name === chosen.value || edge.to.name === chosen.value;
  return (
    <div class="flow-body">
      <svg
        class="flow"
        viewBox={`0 0 ${own.width} ${own.height}`}
        style={{ width: "100%", maxWidth: `${own.width}px`, minWidth: `${own.width * 0.72}px` }}
        role="group"
        aria-label="Signal flow"
      >
        {[...edges]
          .sort((a, b) => Number(hot(a)) - Number(hot(b)))
          .map((edge) => (
            <path
              key={`${edge.from.name} ${edge.to.name}`}
              class={hot(edge) ? "hot" : ""}
              d={wire(edge.from, edge.to, boxes)}
            />
          ))}
        {boxes.map((box) => (
          <g
            key={box.name}
            class={`blk ${box.input ? "in" : box.node!.tables.length ? "par" : ""} ${flow.value!.outputs.includes(box.name) ? "out" : ""} ${box.name === chosen.value ? "now" : ""}`}
            role="button"
            tabIndex={0}
            data-node={box.name}
            onClick={() => {
              chosen.value = box.name;
            }}
            onKeyDown={(event) => {
              if (event.key === "Enter" || event.key === " ") {
                chosen.value = box.name;
                event.preventDefault();
              }
            }}
          >
            <title>
              {box.name}
              {box.node?.tables.length ? `: ${box.node.tables.join(", ")}` : ""}
            </title>
            <rect x={box.x} y={box.y} width={WIDTH} height={HEIGHT} rx="3" />
            <text class="t1" x={box.x + 7} y={box.y + 13}>
              {box.name.length > 13 ? `${box.name.slice(0, 12)}…` : box.name}
            </text>
            <text x={box.x + 7} y={box.y + 26}>
              {box.sign.slice(0, 8)}
            </text>
            <text class="t3" x={box.x + WIDTH - 7} y={box.y + 26}>
              {values.has(box.name) ? numberText(values.get(box.name)) : ""}
            </text>
          </g>
        ))}
      </svg>
    </div>
  );
}
