// The list of everything that can be drawn: type to filter, Enter adds a strip, Shift+Enter adds to the active strip.

import { useSignal } from "@preact/signals";
import { useLayoutEffect, useRef } from "preact/hooks";
import { count, unitText } from "../../drawing/numbers";
import { Icon } from "../../icons";
import { matrixOpen } from "../../plot-data";
import { dataset, keyOf } from "../../plots";
import type { SignalRow } from "../../replies";
import {
  active,
  addLine,
  addStrip,
  listed,
  matrixSignals,
  resetStrips,
  rows,
  SIGNAL,
  searching,
  setMatrix,
} from "../../strip-rows";

const ROW = 24; // pixels

export function SignalSearch() {
  const text = useSignal("");
  const chosen = useSignal(0);
  const top = useSignal(0);
  const list = useRef<HTMLDivElement>(null);
  const field = useRef<HTMLInputElement>(null);
  useLayoutEffect(() => field.current?.focus(), []);
  const words = text.value.toLowerCase().split(/\s+/).filter(Boolean);
  const matching = listed.value.filter((each) => {
    const own = `${each.label} ${each.unit} ${each.group}`.toLowerCase();
    return words.every((word) => own.includes(word));
  });
  const at = Math.max(0, Math.min(chosen.value, matching.length - 1));
  const high = list.current?.clientHeight || 480;
  const first = Math.max(0, Math.floor(top.value / ROW) - 4);
  const shown = matching.slice(first, first + Math.ceil(high / ROW) + 8);
  const drawn = new Set(
    matrixOpen.value
      ? matrixSignals.value.map(keyOf)
      : rows.value.flatMap((row) => row.lines.map((line) => keyOf(line.signal))),
  );

  const go = (next: number) => {
    chosen.value = Math.max(0, Math.min(matching.length - 1, next));
    const element = list.current!;
    const y = chosen.value * ROW;
    if (y < element.scrollTop) element.scrollTop = y;
    else if (y + ROW > element.scrollTop + element.clientHeight) element.scrollTop = y + ROW - element.clientHeight;
  };
  const key = (event: KeyboardEvent) => {
    const page = Math.max(1, Math.floor(high / ROW) - 1);
    const moves: Record<string, () => void> = {
      ArrowDown: () => go(at + 1),
      ArrowUp: () => go(at - 1),
      PageDown: () => go(at + page),
      PageUp: () => go(at - page),
      Escape: () => {
        searching.value = false;
      },
      Enter: () => add(matching[at], event.shiftKey),
    };
    const move = moves[event.key];
    if (move === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    move();
  };
  return (
    <section class="pane search" aria-label="Signals">
      <div class="head">
        <h2>Signals</h2>
        <span class="sub">
          {words.length ? `${count(matching.length)} of ${count(listed.value.length)}` : count(listed.value.length)}
        </span>
        <span class="right">
          <button
            class="btn bare small"
            title={
              matrixOpen.value
                ? "The inputs of the function and the error"
                : "The criteria and the inputs of the function"
            }
            onClick={() => (matrixOpen.value ? setMatrix(null) : resetStrips())}
          >
            Reset
          </button>
          <button
            class="btn bare small"
            aria-label="Close the list of signals"
            title="Close (Esc)"
            onClick={() => {
              searching.value = false;
            }}
          >
            ×
          </button>
        </span>
      </div>
      <div class="filter">
        <label class="field" style={{ width: "100%" }}>
          <Icon name="find" kind="q" />
          <input
            ref={field}
            id="signal-search"
            placeholder="Name, unit, kind"
            aria-label="Search signals"
            role="combobox"
            aria-expanded="true"
            aria-controls="signal-list"
            aria-activedescendant={matching.length ? `signal-${at}` : undefined}
            value={text.value}
            onInput={(event) => {
              text.value = event.currentTarget.value;
              chosen.value = 0;
              list.current!.scrollTop = 0;
            }}
            onKeyDown={key}
          />
        </label>
      </div>
      <div
        class="virtual"
        id="signal-list"
        role="listbox"
        aria-label="Signals"
        ref={list}
        onScroll={(event) => {
          top.value = event.currentTarget.scrollTop;
        }}
      >
        <div style={{ height: `${matching.length * ROW}px` }}>
          {shown.map((each, k) => (
            <Entry
              key={keyOf(each)}
              own={each}
              number={first + k}
              on={first + k === at}
              drawn={drawn.has(keyOf(each))}
            />
          ))}
        </div>
      </div>
      {matching.length === 0 && (
        <p class="pad q">
          {listed.value.length
            ? "No signal has these words in its name, unit or kind."
            : dataset.value
              ? "The signals are being listed."
              : "Add a recording on the Data screen."}
        </p>
      )}
      <p class="hint">
        {matrixOpen.value ? (
          <>
            <kbd>Enter</kbd> into or out of the matrix
          </>
        ) : (
          <>
            <kbd>Enter</kbd> new strip <kbd>Shift</kbd>
            <kbd>Enter</kbd> onto {rows.value[active.value]?.title ?? "a strip"}
          </>
        )}
      </p>
    </section>
  );
}

function add(own: SignalRow | undefined, onto: boolean): void {
  if (own === undefined) return;
  if (!matrixOpen.value) {
    if (onto) addLine(active.value, own);
    else addStrip(own);
    return;
  }
  const others = matrixSignals.value.filter((each) => keyOf(each) !== keyOf(own));
  setMatrix(others.length < matrixSignals.value.length ? others : [...others, own]);
}

function Entry({ own, number, on, drawn }: { own: SignalRow; number: number; on: boolean; drawn: boolean }) {
  return (
    <div
      class={`entry ${on ? "on" : ""}`}
      id={`signal-${number}`}
      role="option"
      aria-selected={on}
      data-signal={keyOf(own)}
      draggable
      title={`${own.label}${own.unit ? ` [${own.unit}]` : ""}, ${own.group}\nClick: a strip of its own. Shift+click or drag: onto a strip`}
      style={{ top: `${number * ROW}px` }}
      onClick={(event) => add(own, event.shiftKey)}
      onDragStart={(event) =>
        event.dataTransfer?.setData(SIGNAL, JSON.stringify({ kind: own.kind, name: own.name, unit: own.unit }))
      }
    >
      <span class="cut ink">{own.label}</span>
      <span class="q">{unitText(own.unit)}</span>
      <span class="tag">{drawn ? "drawn" : own.group}</span>
    </div>
  );
}
