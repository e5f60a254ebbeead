// The blocks of an imported Simulink model as a tree.

import { computed, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { significant } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { flipped } from "../../flipped";
import { Icon } from "../../icons";
import { split } from "../../instruments/error-split";
import type { BlockRow } from "../../replies";
import { scoped } from "../../scope";
import { binding } from "./bindings";
import { promote } from "./block-actions";
import { chosen, diagram } from "./source";

const search = scoped("");
const column = signal("fields");
const opened = scoped(new Set<string>()); // subsystems whose blocks are shown; the top level always is

const SIGNS: Record<string, string> = {
  SubSystem: "▭",
  "MATLAB Function": "ƒ",
  Chart: "◫",
  Sum: "Σ",
  Gain: "▷",
  Product: "×",
  Constant: "#",
  Integrator: "∫",
  DiscreteIntegrator: "∫",
  Inport: "→",
  Outport: "←",
  "Lookup_n-D": "▦",
  Lookup: "▦",
  Lookup2D: "▦",
  Interpolation_n_D: "▦",
  Switch: "⋎",
  MultiPortSwitch: "⋎",
  UnitDelay: "z",
  Delay: "z",
  Memory: "z",
  Saturate: "⊏",
  RelationalOperator: "≥",
  Logic: "∧",
  Goto: "⇥",
  From: "↦",
  Mux: "⊐",
  Demux: "⊏",
};
const WORDS: Record<BlockRow["state"], string> = {
  supported: "can be imported",
  bound: "bound to a channel or formula",
  undefined: "a variable has no value",
  unsupported: "not supported, and an output depends on it",
  unused: "not supported, but no output depends on it",
  unreached: "not checked: behind a block that is not supported",
};
const WORSE: BlockRow["state"][] = ["supported", "unused", "unreached", "bound", "undefined", "unsupported"];

/** The state of each block, of a subsystem the worst of its blocks. */
const states = computed(() => {
  const blocks = diagram.value?.blocks ?? [];
  const result = blocks.map((block) => block.state);
  const parents: number[] = [];
  blocks.forEach((block, k) => {
    parents.length = block.depth;
    for (const parent of parents)
      if (WORSE.indexOf(block.state) > WORSE.indexOf(result[parent]!)) result[parent] = block.state;
    parents.push(k);
  });
  return result;
});

/**
 * Numbers of the blocks that are shown: those of opened subsystems, or those that match the search and what is around
 * them.
 */
const visible = computed(() => {
  const blocks = diagram.value?.blocks ?? [];
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const keep = new Set<number>();
  const parents: number[] = [];
  blocks.forEach((block, k) => {
    parents.length = block.depth;
    const text = `${block.path} ${block.type} ${block.detail}`.toLowerCase();
    if (
      words.length
        ? words.every((word) => text.includes(word))
        : parents.every((parent) => opened.value.has(blocks[parent]!.path))
    )
      [...parents, k].forEach((each) => keep.add(each));
    parents.push(k);
  });
  return [...keep].sort((a, b) => a - b);
});

const valuesAt = computed(() => {
  const values = new Map(split.value?.nodes.map((node) => [node.name, node.now]) ?? []);
  return new Map(
    (diagram.value?.lines ?? [])
      .filter((line) => values.has(line.node))
      .map((line) => [line.path, values.get(line.node)!]),
  );
});

/** Show a block in the tree, with the subsystems around it opened. */
export function reveal(path: string): void {
  const blocks = diagram.value?.blocks ?? [];
  opened.value = new Set([
    ...opened.value,
    ...blocks.filter((block) => block.inner && path.startsWith(`${block.path}/`)).map((block) => block.path),
  ]);
  chosen.value = path;
}

export function BlockTree() {
  const own = diagram.value;
  const list = useRef<HTMLDivElement>(null);
  useEffect(() => {
    list.current?.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest" });
  }, [chosen.value]);
  useEffect(() => {
    opened.value = new Set(
      (own?.blocks ?? [])
        .filter((block) => block.inner && block.depth === 0)
        .slice(0, 6)
        .map((block) => block.path),
    );
  }, [own?.file, own?.subsystem]);
  const blocks = own?.blocks ?? [];
  return (
    <>
      <div class="filter">
        <label class="field grow">
          <Icon name="find" kind="q" />
          <input
            placeholder="Block, type, variable"
            aria-label="Search blocks"
            value={search.value}
            onInput={(event) => {
              search.value = event.currentTarget.value;
            }}
          />
        </label>
        <Segment
          label="Right column"
          options={["fields", "values"]}
          chosen={column.value}
          choose={(next) => {
            column.value = next;
          }}
        />
      </div>
      <div class="tree" role="tree" aria-label="Blocks" tabIndex={0} ref={list} onKeyDown={key}>
        {visible.value.map((k) => (
          <Row key={blocks[k]!.path} block={blocks[k]!} state={states.value[k]!} />
        ))}
        {blocks.length > 0 && visible.value.length === 0 && (
          <p class="pad q">No block has these words in its path, type or field.</p>
        )}
      </div>
    </>
  );
}

function Row({ block, state }: { block: BlockRow; state: BlockRow["state"] }) {
  const open = opened.value.has(block.path) || search.value !== "";
  const value = valuesAt.value.get(block.path);
  return (
    <div
      class={`branch ${chosen.value === block.path ? "on" : ""}`}
      role="treeitem"
      data-block={block.path}
      aria-level={block.depth + 1}
      aria-selected={chosen.value === block.path}
      aria-expanded={block.inner ? open : undefined}
      style={{ paddingLeft: `${8 + 14 * block.depth}px` }}
      title={`${block.path}\n${block.type}${block.field ? `, ${block.field} = ${block.detail}` : ""}\n${WORDS[state]}`}
      onClick={() => {
        chosen.value = block.path;
      }}
      onDblClick={() => toggle(block)}
    >
      <i
        class="chev"
        onClick={(event) => {
          event.stopPropagation();
          toggle(block);
        }}
      >
        {block.inner ? (open ? "⌄" : "›") : ""}
      </i>
      <i class="sign">{SIGNS[block.type] ?? (block.inner ? "▭" : "·")}</i>
      <b class="cut">{block.name}</b>
      <span class="q cut">{block.inner ? `${block.inner} blocks` : block.type}</span>
      <span class="mono detail cut">
        {state === "bound" && block.state === "bound"
          ? "bound"
          : column.value === "values"
            ? value === undefined || value === null
              ? ""
              : significant(value)
            : block.detail}
      </span>
      <Mark state={state} />
    </div>
  );
}

function Mark({ state }: { state: BlockRow["state"] }) {
  if (state === "bound") return <Icon name="link" kind="acc" />;
  if (state === "unsupported" || state === "undefined")
    return <Icon name="warning" kind={state === "undefined" ? "warn" : "bad"} />;
  return state === "unused" || state === "unreached" ? <span class="q">–</span> : <Icon name="done" kind="good" />;
}

function toggle(block: BlockRow): void {
  if (!block.inner) return;
  opened.value = flipped(opened.value, block.path);
}

/** Arrows walk and fold, `b` binds the block, `p` makes its number a parameter. */
function key(event: KeyboardEvent): void {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const blocks = diagram.value?.blocks ?? [];
  const at = visible.value.findIndex((k) => blocks[k]!.path === chosen.value);
  const own = at >= 0 ? blocks[visible.value[at]!] : undefined;
  const go = (to: number) => {
    const next = blocks[visible.value[Math.max(0, Math.min(visible.value.length - 1, to))]!];
    if (next) chosen.value = next.path;
  };
  if (event.key === "ArrowDown") go(at + 1);
  else if (event.key === "ArrowUp") go(at - 1);
  else if (event.key === "Home") go(0);
  else if (event.key === "End") go(visible.value.length - 1);
  else if (event.key === "ArrowRight" && own?.inner && !opened.value.has(own.path)) toggle(own);
  else if (event.key === "ArrowLeft" && own?.inner && opened.value.has(own.path)) toggle(own);
  else if (event.key === "ArrowLeft" && own?.path.includes("/"))
    go(visible.value.slice(0, at).findLastIndex((k) => blocks[k]!.depth < own.depth));
  else if (event.key === "b" && own) binding.value = own.path;
  else if (event.key === "p" && own) promote();
  else return;
  event.preventDefault();
}
