// Fields that show a key of the project file and change it. Each says in its tooltip what it means and which key it is.

import { useSignal } from "@preact/signals";
import { parseNumber } from "./drawing/numbers";
import { describePath, messagesOf, setKeys, valueAt, type Path, type Toml } from "./settings";

interface FieldProps { path: Path; label: string; help?: string; width?: number; placeholder?: string; unit?: string }

function title({ path, help }: FieldProps): string {
  const own = messagesOf(path).value.map((f) => f.text);
  return [help, describePath(path), ...own].filter(Boolean).join("\n");
}

const kind = (path: Path): string => (messagesOf(path).value.some((f) => f.severity === "error") ? "bad" : "");

/** A number; empty removes the key, so that the default shown in grey counts. */
export function NumberField(props: FieldProps) {
  const own = valueAt(props.path);
  const typed = useSignal<string | null>(null);
  const text = typed.value ?? (own === undefined ? "" : typeof own === "number" ? asTyped(own) : String(own));
  const commit = () => {
    const entered = typed.value;
    typed.value = null;
    if (entered === null) return;
    if (entered.trim() === "") {
      if (own !== undefined) void setKeys([[props.path, null]], `${props.label}: default`);
      return;
    }
    const value = parseNumber(entered);
    const next: Toml = value === null ? entered.trim() : value;
    if (next !== own) void setKeys([[props.path, next]], `${props.label}: ${entered.trim()}`);
  };
  return (
    <span class={`field small num ${kind(props.path)} ${own === undefined ? "empty" : ""}`} style={{ width: `${props.width ?? 56}px` }} title={title(props)}>
      <input aria-label={props.label} value={text} placeholder={props.placeholder} inputMode="decimal" onInput={(event) => { typed.value = event.currentTarget.value; }} onBlur={commit} onKeyDown={(event) => { if (event.key === "Enter") event.currentTarget.blur(); if (event.key === "Escape") { typed.value = null; event.currentTarget.blur(); } }} />
      {props.unit && <u>{props.unit}</u>}
    </span>
  );
}


/** A number as one would type it. */
const asTyped = (value: number): string => String(value).replace("e+", "e");

export function TextField(props: FieldProps & { mono?: boolean }) {
  const own = valueAt(props.path);
  const typed = useSignal<string | null>(null);
  const commit = () => {
    const entered = typed.value;
    typed.value = null;
    if (entered === null || entered === (own ?? "")) return;
    void setKeys([[props.path, entered === "" ? null : entered]], `${props.label}: ${entered || "none"}`);
  };
  return (
    <span class={`field small ${kind(props.path)} ${props.mono ? "mono" : ""}`} style={{ width: props.width ? `${props.width}px` : "100%" }} title={title(props)}>
      <input aria-label={props.label} value={typed.value ?? (own === undefined ? "" : String(own))} placeholder={props.placeholder} onInput={(event) => { typed.value = event.currentTarget.value; }} onBlur={commit} onKeyDown={(event) => { if (event.key === "Enter") event.currentTarget.blur(); if (event.key === "Escape") { typed.value = null; event.currentTarget.blur(); } }} />
    </span>
  );
}

/** One of a few words; the first is the default, for which the key is removed. */
export function ChoiceField(props: FieldProps & { options: string[] }) {
  const own = valueAt(props.path) ?? props.options[0];
  return (
    <select class={`field small ${kind(props.path)}`} aria-label={props.label} title={title(props)} style={{ width: `${props.width ?? 84}px` }} value={String(own)} onChange={(event) => {
      const value = event.currentTarget.value;
      void setKeys([[props.path, value === props.options[0] ? null : value]], `${props.label}: ${value}`);
    }}>{props.options.map((each) => <option value={each}>{each}</option>)}</select>
  );
}

/** A few words side by side, one of which is chosen. */
export function Segment(props: { options: string[]; chosen: string; choose: (option: string) => void; label: string }) {
  return <span class="seg tight" role="group" aria-label={props.label}>{props.options.map((each) => <button aria-pressed={each === props.chosen} onClick={() => props.choose(each)}>{each}</button>)}</span>;
}

/** Two numbers, such as bounds; both empty removes the key, one empty is no limit on that side. */
export function PairField(props: FieldProps & { none?: string }) {
  const own = valueAt(props.path);
  const pair = Array.isArray(own) && own.length === 2 && own.every((side) => typeof side === "number" || typeof side === "string") ? own : null;
  const typed = useSignal<[string | null, string | null]>([null, null]);
  if (own !== undefined && pair === null) return <span class="field small" title={title(props)}>a table of values</span>;
  const shown = (side: 0 | 1): string => {
    if (typed.value[side] !== null) return typed.value[side]!;
    const value = pair?.[side];
    return value === undefined || String(value).endsWith("inf") ? "" : String(value);
  };
  const commit = () => {
    if (typed.value[0] === null && typed.value[1] === null) return;
    const sides = [shown(0), shown(1)].map((text, side) => (text.trim() === "" ? (side ? Infinity : -Infinity) : parseNumber(text)));
    typed.value = [null, null];
    const [low, high] = sides;
    if (low === null || high === null) return;
    const next = low === -Infinity && high === Infinity ? null : [infinite(low!), infinite(high!)];
    if (JSON.stringify(next) !== JSON.stringify(pair)) void setKeys([[props.path, next]], `${props.label}: ${next === null ? "none" : next.join(" to ")}`);
  };
  const side = (which: 0 | 1) => (
    <span class={`field small num ${kind(props.path)}`} style={{ width: "54px" }}>
      <input aria-label={`${props.label}, ${which ? "upper" : "lower"}`} value={shown(which)} placeholder={which ? "∞" : "−∞"} onInput={(event) => { const next: [string | null, string | null] = [...typed.value]; next[which] = event.currentTarget.value; typed.value = next; }} onBlur={commit} onKeyDown={(event) => { if (event.key === "Enter") event.currentTarget.blur(); if (event.key === "Escape") { typed.value = [null, null]; event.currentTarget.blur(); } }} />
    </span>
  );
  return <span class="row" title={title(props)}>{side(0)}<span class="q">…</span>{side(1)}</span>;
}

const infinite = (value: number): Toml => (value === Infinity ? "inf" : value === -Infinity ? "-inf" : value);

/** A number on a logarithmic slider, from 0 (off) over 1e-3 to 1e6, and as text. */
export function LogSlider(props: FieldProps) {
  const own = valueAt(props.path);
  const value = typeof own === "number" ? own : 0;
  const position = value > 0 ? Math.log10(value) + 4 : 0;
  const dragged = useSignal<number | null>(null);
  const numberAt = (at: number) => (at <= 0 ? 0 : Number((10 ** (at - 4)).toPrecision(2)));
  return (
    <span class="row" title={title(props)}>
      <input class="slide" type="range" min="0" max="10" step="0.1" aria-label={`${props.label}, logarithmic`} value={dragged.value ?? position} onInput={(event) => { dragged.value = Number(event.currentTarget.value); }}
        onChange={(event) => { dragged.value = null; const next = numberAt(Number(event.currentTarget.value)); void setKeys([[props.path, next || null]], `${props.label}: ${next}`); }} />
      <NumberField {...props} width={48} placeholder="0" />
    </span>
  );
}
