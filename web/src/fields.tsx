// Fields that show a key of the project file and change it. What each means, its default and its limits come from the
// schema.

import { useSignal } from "@preact/signals";
import { ChoiceInput, LineInput, NumberInput, PairInput } from "./inputs";
import type { KeyRow, Path, Toml } from "./replies";
import { keyAt, settingName } from "./schema";
import { describePath, messagesWithin, setKeys, valueAt } from "./settings";

interface FieldProps {
  path: Path;
  label: string;
  help?: string;
  width?: number;
  placeholder?: string;
  unit?: string;
}

/** What a key means, as a tooltip says it. */
export function tooltip(path: Path, key: KeyRow | undefined, help = key?.help ?? ""): string {
  const facts =
    key === undefined ? "" : [key.type, key.unit, key.default && `default: ${key.default}`].filter(Boolean).join(", ");
  return [help, facts, describePath(path), ...messagesWithin(path, key).map((f) => f.text)].filter(Boolean).join("\n");
}

const title = ({ path, help }: FieldProps): string => tooltip(path, keyAt(path), help);
const bad = (path: Path): boolean => messagesWithin(path, keyAt(path)).some((f) => f.severity === "error");
const set = (props: FieldProps, value: Toml | null, text: string): void => {
  void setKeys([[props.path, value]], `${props.label}: ${text || "default"}`);
};

/** A default as a narrow field shows it: without the cases in which it is another one. */
const briefDefault = (key: KeyRow | undefined): string | undefined => key?.default.split(/[;,] /)[0];

/** A number; empty removes the key, so that the default shown in grey counts. */
export function NumberField(props: FieldProps) {
  const [own, key] = [valueAt(props.path), keyAt(props.path)];
  const unit = props.unit ?? key?.unit;
  return (
    <span
      class={`field small num ${bad(props.path) ? "bad" : ""} ${own === undefined ? "empty" : ""}`}
      data-setting={settingName(props.path)}
      style={{ minWidth: `${props.width ?? 56}px` }}
      title={title(props)}
    >
      <NumberInput
        label={props.label}
        placeholder={props.placeholder ?? briefDefault(key)}
        own={own}
        enter={(value, text) => set(props, value, text)}
      />
      {unit && <u>{unit}</u>}
    </span>
  );
}

export function TextField(props: FieldProps & { mono?: boolean }) {
  const [own, key] = [valueAt(props.path), keyAt(props.path)];
  return (
    <span
      class={`field small ${bad(props.path) ? "bad" : ""} ${props.mono ? "mono" : ""}`}
      data-setting={settingName(props.path)}
      style={{ width: props.width ? `${props.width}px` : "100%" }}
      title={title(props)}
    >
      <LineInput
        label={props.label}
        placeholder={props.placeholder ?? key?.default}
        text={own === undefined ? "" : String(own)}
        enter={(text) => set(props, text === "" ? null : text, text)}
      />
    </span>
  );
}

/** One of a few words; the key is removed for the default. */
export function ChoiceField(props: FieldProps & { options?: string[] }) {
  const key = keyAt(props.path);
  const options = props.options ?? key?.form.options ?? [];
  const standard = options.find((each) => each === key?.default.replaceAll('"', "")) ?? options[0]!;
  return (
    <span class="row" data-setting={settingName(props.path)} title={title(props)}>
      <ChoiceInput
        own={String(valueAt(props.path) ?? standard)}
        options={options}
        label={props.label}
        bad={bad(props.path)}
        width={props.width ?? 84}
        choose={(option) => set(props, option === standard ? null : option, option)}
      />
    </span>
  );
}

/** A few words side by side, one of which is chosen. */
export function Segment(props: { options: string[]; chosen: string; choose: (option: string) => void; label: string }) {
  return (
    <span class="seg tight" role="group" aria-label={props.label}>
      {props.options.map((each) => (
        <button aria-pressed={each === props.chosen} onClick={() => props.choose(each)}>
          {each}
        </button>
      ))}
    </span>
  );
}

/** Two numbers, such as bounds; both empty removes the key, one empty is no limit on that side. */
export function PairField(props: FieldProps) {
  const own = valueAt(props.path);
  const pair = Array.isArray(own) && own.length === 2 && own.every((side) => typeof side !== "object") ? own : null;
  if (own !== undefined && pair === null)
    return (
      <span class="field small" title={title(props)}>
        a table of values
      </span>
    );
  return (
    <span class="row" data-setting={settingName(props.path)} title={title(props)}>
      <PairInput
        own={pair}
        label={props.label}
        bad={bad(props.path)}
        enter={(value) => set(props, value, value === null ? "none" : (value as Toml[]).join(" to "))}
      />
    </span>
  );
}

/** A number on a logarithmic slider, from 0 (off) over 1e-3 to 1e6, and as text. */
export function LogSlider(props: FieldProps) {
  const own = valueAt(props.path);
  const value = typeof own === "number" ? own : 0;
  const position = value > 0 ? Math.log10(value) + 4 : 0;
  const dragged = useSignal<number | null>(null);
  const numberAt = (at: number) => (at <= 0 ? 0 : Number((10 ** (at - 4)).toPrecision(2)));
  return (
    <span class="row" title={title(props)}>
      <input
        class="slide"
        type="range"
        min="0"
        max="10"
        step="0.1"
        aria-label={`${props.label}, logarithmic`}
        value={dragged.value ?? position}
        onInput={(event) => {
          dragged.value = Number(event.currentTarget.value);
        }}
        onChange={(event) => {
          dragged.value = null;
          const next = numberAt(Number(event.currentTarget.value));
          void setKeys([[props.path, next || null]], `${props.label}: ${next}`);
        }}
      />
      {typeof own === "object" ? (
        <span class="field small" title={title(props)}>
          by axis
        </span>
      ) : (
        <NumberField {...props} width={48} />
      )}
    </span>
  );
}
