// The unit and the values of the node that a line of formula text defines, beside the line.

import { type Extension, StateEffect } from "@codemirror/state";
import { GutterMarker, gutter } from "@codemirror/view";
import { numberText, unitText } from "../drawing/numbers";
import { split } from "./error-split";

const changed = StateEffect.define<null>();

/** The effect with which an editor draws the values again. */
export const valuesChanged = changed.of(null);

class NodeMarker extends GutterMarker {
  constructor(
    readonly unit: string,
    readonly start: string,
    readonly now: string,
  ) {
    super();
  }
  eq(other: NodeMarker): boolean {
    return other.unit === this.unit && other.start === this.start && other.now === this.now;
  }
  toDOM(): Node {
    const cells = document.createElement("span");
    cells.className = "node-value";
    for (const [kind, text] of [
      ["node-unit", this.unit],
      ["node-start", this.start],
      ["node-now", this.now],
    ] as const) {
      const cell = document.createElement("span");
      cell.className = kind;
      cell.textContent = text;
      cells.append(cell);
    }
    return cells;
  }
}

const DEFINES = /^\s*(?:\d+\s+)?(?:%((?:[^%]|%%)*)%|([A-Za-z_][\w.]*))\s*(?:\[([^\]]*)\])?\s*=(?!=)/;

/** The node that a line of formula text defines, empty if it defines none. */
export function nodeOf(text: string): string {
  const match = DEFINES.exec(text);
  return match === null ? "" : (match[1]?.replaceAll("%%", "%") ?? match[2]!);
}

/** True for a line that defines no node, or one that is said to have no unit. */
export function isUnitless(text: string): boolean {
  const match = DEFINES.exec(text);
  return match === null || unitText(match[3] ?? "?") === "";
}

const EMPTY = new NodeMarker("", "", "");

/** A column at the right with the unit, the value at the start and the present value of each line's node. */
export const nodeValues: Extension = gutter({
  class: "node-values",
  side: "after",
  lineMarker: (view, line) => {
    const text = view.state.doc.sliceString(line.from, Math.min(line.to, line.from + 200));
    const name = nodeOf(text);
    if (name === "") return null;
    const node = split.peek()?.nodes.find((each) => each.name === name);
    return node === undefined
      ? EMPTY
      : new NodeMarker(unitText(DEFINES.exec(text)![3] ?? node.unit), numberText(node.start), numberText(node.now));
  },
  lineMarkerChange: (update) =>
    update.transactions.some((transaction) => transaction.effects.some((effect) => effect.is(changed))),
  initialSpacer: () => new NodeMarker("mmmm", "−00000.0", "−00000.0"),
});
