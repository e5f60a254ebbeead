// Inputs of single values. Each shows a value, and reports what was entered on Enter or when it is left; Escape forgets
// it. Undo within a field takes back what was typed; if nothing was, the last command.

import { useSignal } from "@preact/signals";
import { parseNumber } from "./drawing/numbers";
import type { Toml } from "./replies";
import { names } from "./schema";
import { move } from "./store";

export interface InputProps {
  label: string;
  placeholder?: string;
  mono?: boolean;
  numeric?: boolean;
  holds?: string;
  words?: string[];
  id?: string;
}

/** What is typed into a field of text, until it is entered; `keys` handles undo and Escape. */
function useTyped(text: string, enter: (text: string) => void) {
  const typed = useSignal<string | null>(null);
  const commit = () => {
    const entered = typed.value;
    typed.value = null;
    if (entered !== null && entered.trim() !== text) enter(entered.trim());
  };
  const keys = (event: KeyboardEvent) => {
    const undo =
      (event.ctrlKey || event.metaKey) && typed.value === null
        ? { z: "undo", y: "redo" }[event.key.toLowerCase()]
        : undefined;
    if (undo) {
      event.preventDefault();
      void move(undo as "undo" | "redo");
    }
    if (event.key !== "Escape" || typed.value === null) return;
    typed.value = null;
    event.stopPropagation();
  };
  return { typed, commit, keys, shown: typed.value ?? text };
}

/** A line of text; `enter` gets what was typed, if it differs. */
export function LineInput(props: InputProps & { text: string; enter: (text: string) => void }) {
  const { typed, commit, keys, shown } = useTyped(props.text, props.enter);
  const list = props.holds ? names.value[props.holds] : props.words;
  const listName = list?.length ? `list-${(props.holds || list.join()).replace(/\W/g, "-")}` : undefined;
  return (
    <>
      <input
        id={props.id}
        aria-label={props.label}
        value={shown}
        placeholder={props.placeholder}
        list={listName}
        inputMode={props.numeric ? "decimal" : undefined}
        spellcheck={false}
        autocomplete="off"
        onInput={(event) => {
          typed.value = event.currentTarget.value;
        }}
        onBlur={commit}
        onKeyDown={(event) => {
          if (event.key === "Enter") commit();
          keys(event);
        }}
      />
      {listName && (
        <datalist id={listName}>
          {list!.map((each) => (
            <option value={each} />
          ))}
        </datalist>
      )}
    </>
  );
}

const FEWEST = 3; // lines of a text area

/** Lines of text, entered when they are left, or with Ctrl+Enter. */
export function LinesInput({
  label,
  text,
  placeholder,
  enter,
}: {
  label: string;
  text: string;
  placeholder?: string;
  enter: (text: string) => void;
}) {
  const { typed, commit, keys, shown } = useTyped(text, enter);
  return (
    <textarea
      aria-label={label}
      value={shown}
      placeholder={placeholder}
      rows={Math.max(FEWEST, Math.min(12, shown.split("\n").length))}
      onInput={(event) => {
        typed.value = event.currentTarget.value;
      }}
      onBlur={commit}
      onKeyDown={(event) => {
        if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) commit();
        keys(event);
      }}
    />
  );
}

/** A number as one would type it. */
const asTyped = (value: Toml | undefined): string =>
  value === undefined ? "" : typeof value === "object" ? "" : String(value).replace("e+", "e");

/**
 * A number, or one of `words`; null if it is emptied. What is neither is reported as typed, for the check to refuse.
 */
export function NumberInput(
  props: InputProps & { own: Toml | undefined; enter: (value: Toml | null, text: string) => void },
) {
  const enter = (text: string) => {
    const value = parseNumber(text);
    props.enter(text === "" ? null : value === null ? text : finite(value), text);
  };
  return <LineInput {...props} numeric text={asTyped(props.own)} enter={enter} />;
}

/** An infinite number has no JSON. */
export const finite = (value: number): Toml => (value === Infinity ? "inf" : value === -Infinity ? "-inf" : value);

/** Numbers side by side, "0 0,5 1" or "0; 0.5; 1", or one of `words`. */
export function NumbersInput(
  props: InputProps & { own: Toml | undefined; enter: (value: Toml | null, text: string) => void },
) {
  const list = Array.isArray(props.own) ? props.own : props.own === undefined ? [] : [props.own];
  return (
    <LineInput
      {...props}
      text={list.map(asTyped).join("  ")}
      enter={(text) =>
        props.enter(text === "" ? null : (props.words ?? []).includes(text) ? text : numbersOf(text), text)
      }
    />
  );
}

/** Return the numbers of a line; what is not one stays as it is, for the check to refuse. */
function numbersOf(text: string): Toml[] {
  const plain = text.replace(/^\[|\]$/g, "").trim();
  const coarse = plain.split(/[;\s]+|,\s+/).filter(Boolean);
  const parts = coarse.length === 1 && parseNumber(coarse[0]!) === null ? coarse[0]!.split(",") : coarse;
  return parts.map((part) => {
    const value = parseNumber(part);
    return value === null ? part : finite(value);
  });
}

/** Two numbers, such as bounds: both empty is none, one empty is no limit on that side. */
export function PairInput({
  own,
  label,
  bad,
  enter,
}: {
  own: Toml[] | null;
  label: string;
  bad: boolean;
  enter: (value: Toml | null) => void;
}) {
  const shown = (side: 0 | 1): string => {
    const value = own?.[side];
    return value === undefined || String(value).endsWith("inf") ? "" : String(value);
  };
  const take = (side: 0 | 1, text: string) => {
    const ends = ([0, 1] as const).map((each) => {
      const entered = each === side ? text : shown(each);
      return entered === "" ? (each ? Infinity : -Infinity) : (parseNumber(entered) ?? entered);
    });
    enter(
      ends[0] === -Infinity && ends[1] === Infinity
        ? null
        : ends.map((end) => (typeof end === "number" ? finite(end) : end)),
    );
  };
  const side = (which: 0 | 1) => (
    <span class={`field small num ${bad ? "bad" : ""}`} style={{ width: "58px" }}>
      <LineInput
        label={`${label}, ${which ? "upper" : "lower"}`}
        placeholder={which ? "∞" : "−∞"}
        numeric
        text={shown(which)}
        enter={(text) => take(which, text)}
      />
    </span>
  );
  return (
    <span class="row">
      {side(0)}
      <span class="q">…</span>
      {side(1)}
    </span>
  );
}

/** One of a few words; the first stands for the default if `own` is not one of them. */
export function ChoiceInput({
  own,
  options,
  none,
  label,
  bad,
  width,
  choose,
}: {
  own: string | undefined;
  options: string[];
  none?: string;
  label: string;
  bad: boolean;
  width?: number;
  choose: (option: string) => void;
}) {
  return (
    <select
      class={`field small ${bad ? "bad" : ""} ${own === undefined ? "empty" : ""}`}
      aria-label={label}
      style={width ? { width: `${width}px` } : undefined}
      value={own ?? ""}
      onChange={(event) => choose(event.currentTarget.value)}
    >
      {none !== undefined && <option value="">{none}</option>}
      {own !== undefined && !options.includes(own) && <option value={own}>{own}</option>}
      {options.map((each) => (
        <option value={each}>{each}</option>
      ))}
    </select>
  );
}
