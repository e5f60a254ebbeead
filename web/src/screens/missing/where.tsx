// The function with the term: the proposed place in amber, places that explain the same dashed.

import { flow, loadFlowIf } from "../../function-flow";
import { edgesOf, flowLayout, HEIGHT, WIDTH, wire } from "../../instruments/flow-layout";
import { choose, chosen, otherPlace, place, proposal } from "../../missing";
import type { FunctionFlow, TermRow } from "../../replies";
import { screen } from "../../store";

const ROOM = 5; // columns of the pane

loadFlowIf(() => screen.value === "missing");

const table = (channels: readonly string[]) => (channels.length > 1 ? "new map" : "new curve");

const BOXES: Record<TermRow["kind"], (channels: readonly string[]) => [title: string, sign: string]> = {
  add: (channels) => [`+ ${channels.join(", ")}`, table(channels)],
  multiply: (channels) => [`× ${channels.join(", ")}`, table(channels)],
  lag: () => ["PT1", "new lag"],
  delay: () => ["delay", "new delay"],
  offset: () => ["+ offset", "by recording"],
};

/** The name of the box of a term; no node has it. */
const NEW = "\u0000term";

/** The function with a term behind its node. */
function withTerm(own: FunctionFlow, node: string, channels: readonly string[]): FunctionFlow {
  const target = own.nodes.findIndex((each) => each.name === node);
  if (target < 0) return own;
  const sources = [node, ...channels];
  const added = { name: NEW, sources, tables: [], kind: "" };
  const rest = own.nodes.map((each) => ({
    ...each,
    sources: each.sources.map((name) => (name === node ? NEW : name)),
  }));
  const unknown = channels.filter(
    (channel) => !own.inputs.includes(channel) && !own.nodes.some((each) => each.name === channel),
  );
  return {
    inputs: [...own.inputs, ...unknown],
    nodes: [...rest.slice(0, target + 1), added, ...rest.slice(target + 1)],
    outputs: own.outputs,
  };
}

export function WherePane() {
  const own = proposal.value;
  const at = otherPlace.value ?? own;
  const channels = [own?.channel ?? "", own?.second ?? ""].filter(Boolean);
  const layout =
    flow.value === null || own === null || at === null
      ? null
      : flowLayout(withTerm(flow.value, at.node, channels), at.node, ROOM);
  if (own === null || at === null)
    return (
      <section class="pane where">
        <div class="head">
          <h2>Where</h2>
        </div>
        <p class="pad q">
          The place of a proposal, its curve over the channel and the change of the formula stand here.
        </p>
      </section>
    );
  const [title, sign] = BOXES[at.kind](channels);
  const boxes = [...(layout?.boxes.values() ?? [])];
  const alternatives = new Map(own.places.map((each) => [each.node, each.number] as const).toReversed());
  const isNew = (name: string) => name === NEW || channels.includes(name);
  return (
    <section class="pane where" aria-label="Where">
      <div class="head">
        <h2>Where</h2>
        <span class="right">
          <span class="key">
            <i class="box new" />
            proposal {chosen.value + 1}
          </span>
          {own.places.length > 0 && (
            <span class="key">
              <i class="box alt" />
              as good
            </span>
          )}
        </span>
      </div>
      {layout === null ? (
        <p class="pad q">The function is drawn here.</p>
      ) : (
        <div class="fl-body">
          <svg
            class="flow fl"
            viewBox={`-4 -4 ${layout.width + 8} ${layout.height + 8}`}
            role="group"
            aria-label="Signal flow"
          >
            {edgesOf(layout).map(({ from, to }) => (
              <path
                key={`${from.name} ${to.name}`}
                class={to.name === NEW || from.name === NEW ? "hot" : ""}
                d={wire(from, to, boxes)}
              />
            ))}
            {boxes.map((box) => {
              const equal = box.name === own.node && place.value !== null ? null : alternatives.get(box.name);
              const other = equal !== undefined && box.name !== at.node;
              const name = box.name === NEW ? title : box.name;
              return (
                <g
                  key={box.name}
                  class={`blk ${box.input ? "in" : box.node?.tables.length ? "par" : ""} ${flow.value!.outputs.includes(box.name) ? "out" : ""} ${isNew(box.name) ? "new" : ""}`}
                  role={other ? "button" : undefined}
                  tabIndex={other ? 0 : undefined}
                  data-node={box.name === NEW ? "term" : box.name}
                  onClick={() => {
                    if (other) pick(equal);
                  }}
                  onKeyDown={(event) => {
                    if (other && (event.key === "Enter" || event.key === " ")) {
                      pick(equal);
                      event.preventDefault();
                    }
                  }}
                >
                  <title>{other ? `${box.name} explains as much: put the term there` : name}</title>
                  {other && (
                    <rect class="alt" x={box.x - 3} y={box.y - 3} width={WIDTH + 6} height={HEIGHT + 6} rx="5" />
                  )}
                  <rect x={box.x} y={box.y} width={WIDTH} height={HEIGHT} rx="3" />
                  <text class="t1" x={box.x + 7} y={box.y + 13}>
                    {name.length > 14 ? `${name.slice(0, 13)}…` : name}
                  </text>
                  <text x={box.x + 7} y={box.y + 26}>
                    {box.name === NEW ? sign : box.sign.slice(0, 10)}
                  </text>
                </g>
              );
            })}
          </svg>
        </div>
      )}
    </section>
  );
}

/** Put the term at an equal place, or back to the best one. */
function pick(equal: number | null): void {
  if (equal === null) choose(chosen.value);
  else place.value = equal;
}
