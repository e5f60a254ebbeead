// What can be done with the chosen block: replace it, or make the number in its field a parameter.

import { plain } from "../../drawing/numbers";
import type { BlockRow } from "../../replies";
import { setKeys, valueAt } from "../../settings";
import { binding } from "./bindings";
import { chosen, diagram } from "./source";

const chosenBlock = (): BlockRow | undefined => diagram.value?.blocks?.find((block) => block.path === chosen.value);

/** The number in the field of a block, null if it is something else, or a parameter already. */
function literal(block: BlockRow): number | null {
  const value = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(block.detail) ? Number(block.detail) : null;
  return value === null || valueAt(["parameters", `${block.path}:${block.field}`]) !== undefined ? null : value;
}

/** Make the number in the field of the chosen block a parameter. */
export function promote(): void {
  const block = chosenBlock();
  const value = block && literal(block);
  if (block === undefined || value === null || value === undefined) return;
  const name = `${block.path}:${block.field}`;
  void setKeys([[["parameters", name], { initial: value }]], `${name} is a parameter`);
}

export function BlockActions() {
  const block = chosenBlock();
  if (block === undefined) return null;
  const value = literal(block);
  return (
    <div class="actions row" aria-label="Chosen block">
      <b class="cut ink" title={block.path}>
        {block.name}
      </b>
      <span class="right row">
        {value !== null && (
          <button
            class="btn small"
            title={`The number becomes a parameter that can be calibrated (p)\n[parameters."${block.path}:${block.field}"]`}
            onClick={promote}
          >
            {block.field} {plain(value)} as parameter
          </button>
        )}
        {!block.inner && (
          <button
            class="btn small"
            title="A channel or a formula in place of the block (b)"
            onClick={() => {
              binding.value = block.path;
            }}
          >
            Bind…
          </button>
        )}
      </span>
    </div>
  );
}
