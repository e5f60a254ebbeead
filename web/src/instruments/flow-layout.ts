// Where the nodes of a function are drawn: each to the right of what it reads.

import type { FlowNode, FunctionFlow } from "../replies";

export interface Box {
  name: string;
  sign: string;
  x: number;
  y: number;
  input: boolean;
  node?: FlowNode;
}

export interface FlowLayout {
  boxes: Map<string, Box>;
  width: number;
  height: number;
}

export const WIDTH = 102;
export const HEIGHT = 32;
export const GAP = 22;
const MOST = 60; // boxes that are drawn; of larger functions those around the chosen node

const SIGNS: Record<string, string> = {
  add: "+",
  sub: "−",
  mul: "×",
  div: "÷",
  neg: "−",
  state: "memory",
  select: "if",
  input: "input",
  const: "constant",
};

/** The nodes and inputs that are drawn. */
function around(own: FunctionFlow, chosen: string): Set<string> {
  const names = [...own.inputs, ...own.nodes.map((node) => node.name)];
  if (names.length <= MOST) return new Set(names);
  const kept = new Set<string>([chosen || (own.outputs[0] ?? own.nodes.at(-1)!.name)]);
  for (let grown = true; grown && kept.size < MOST; ) {
    const before = kept.size;
    for (const node of own.nodes) {
      if (kept.size >= MOST) break;
      if (kept.has(node.name)) node.sources.forEach((name) => kept.add(name));
      else if (node.sources.some((name) => kept.has(name))) kept.add(node.name);
    }
    grown = kept.size > before;
  }
  return kept;
}

/** Each node one column to the right of what it reads; reads of earlier samples close a loop and do not count. */
function columns(own: FunctionFlow, drawn: Set<string>): Map<string, number> {
  const byName = new Map(own.nodes.map((node) => [node.name, node]));
  const ranks = new Map<string, number>();
  const entered = new Set<string>();
  const rank = (name: string): number => {
    const known = ranks.get(name);
    if (known !== undefined) return known;
    if (entered.has(name)) return -1;
    entered.add(name);
    const sources = (byName.get(name)?.sources ?? []).filter((each) => drawn.has(each));
    const value = byName.has(name) ? 1 + Math.max(0, ...sources.map(rank)) : 0;
    ranks.set(name, value);
    return value;
  };
  drawn.forEach(rank);
  return ranks;
}

/** Lay out the nodes and inputs, in a number of columns, of a large function those around the chosen node. */
export function flowLayout(own: FunctionFlow, chosen: string, room: number): FlowLayout | null {
  if (own.nodes.length === 0) return null;
  const drawn = around(own, chosen);
  const byName = new Map(own.nodes.map((node) => [node.name, node]));
  const ranks = columns(own, drawn);
  const last = Math.max(...ranks.values());
  const fit = (rank: number): number =>
    last < room || rank < 2 ? rank : 1 + Math.ceil(((rank - 1) * (room - 2)) / (last - 1));
  const byColumn: string[][] = [];
  for (const [name, rank] of ranks) byColumn[fit(rank)] = [...(byColumn[fit(rank)] ?? []), name];
  const boxes = new Map<string, Box>();
  byColumn.filter(Boolean).forEach((names, column) => {
    const height = (name: string): number => {
      const ys = (byName.get(name)?.sources ?? []).flatMap((each) => boxes.get(each)?.y ?? []);
      return ys.length ? ys.reduce((sum, y) => sum + y, 0) / ys.length : 0;
    };
    if (column > 0) names.sort((a, b) => ranks.get(a)! - ranks.get(b)! || height(a) - height(b));
    let y = 4;
    for (const name of names) {
      const node = byName.get(name);
      y = Math.max(y, column > 0 ? height(name) : 0);
      boxes.set(name, {
        name,
        x: 2 + column * (WIDTH + GAP),
        y,
        input: node === undefined,
        sign: node === undefined ? "" : node.tables[0] ? node.kind : (SIGNS[node.kind] ?? node.kind),
        node,
      });
      y += HEIGHT + 12;
    }
  });
  const all = [...boxes.values()];
  return {
    boxes,
    width: Math.max(...all.map((box) => box.x)) + WIDTH + 4,
    height: Math.max(...all.map((box) => box.y)) + HEIGHT + 4,
  };
}

export interface Edge {
  from: Box;
  to: Box;
}

/** What the drawn nodes read of each other; no line leads from a node to itself. */
export function edgesOf({ boxes }: FlowLayout): Edge[] {
  return [...boxes.values()].flatMap((to) =>
    (to.node?.sources ?? []).flatMap((name) => {
      const from = boxes.get(name);
      return from && from !== to ? [{ from, to }] : [];
    }),
  );
}

const MARGIN = 5; // between a line and a box that it passes

/** The height at which a line passes the boxes between two others: near both its ends, and through none of them. */
function lane(from: Box, to: Box, boxes: Box[]): number {
  const between = boxes.filter((box) => box.x > from.x && box.x < to.x);
  const [y1, y2] = [from.y + HEIGHT / 2, to.y + HEIGHT / 2];
  const free = (y: number): boolean => !between.some((box) => y > box.y - 3 && y < box.y + HEIGHT + 3);
  const beside = between.flatMap((box) => [box.y - MARGIN, box.y + HEIGHT + MARGIN]);
  const detour = (y: number): number => Math.abs(y - y1) + Math.abs(y - y2);
  return [y1, y2, ...beside].filter((y) => y > 0 && free(y)).sort((a, b) => detour(a) - detour(b))[0] ?? y1;
}

/** The line from one box to another: to the right, up or down in the gaps behind the source and before the target. */
export function wire(from: Box, to: Box, boxes: Box[]): string {
  const [x1, y1, x2, y2] = [from.x + WIDTH, from.y + HEIGHT / 2, to.x, to.y + HEIGHT / 2];
  if (from.x === to.x && to.y > from.y)
    return to.y - from.y < 2 * HEIGHT
      ? `M${from.x + WIDTH / 2},${from.y + HEIGHT} V${to.y}`
      : `M${x1},${y1} h7 V${to.y - 6} H${from.x + WIDTH / 2} v6`;
  if (x2 <= x1) return `M${x1},${y1} h6 V${Math.max(from.y, to.y) + HEIGHT + 6} H${x2 - 6} V${y2} h6`;
  const bend = x2 - 6 - (Math.round(y1) % 5) * 4;
  const y = lane(from, to, boxes);
  return y === y1
    ? `M${x1},${y1} H${bend} V${y2} H${x2}`
    : `M${x1},${y1} h${4 + (Math.round(y1) % 5)} V${y} H${bend} V${y2} H${x2}`;
}
