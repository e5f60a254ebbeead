// A field for a value of any form: a number, a choice, a table, a list of entries and so on, within each other.

import { useSignal } from "@preact/signals";
import type { JSX } from "preact";
import { ask } from "../connection";
import { ChoiceInput, LineInput, LinesInput, NumberInput, NumbersInput, PairInput } from "../inputs";
import type { KeyForm, KeyRow, Path, Toml } from "../replies";
import { asToml, brief, directionsOf, names, shows } from "../schema";

type Table = { [key: string]: Toml };

export interface ValueProps {
  form: KeyForm;
  own: Toml | undefined;
  label: string;
  path: Path;
  known: Pick<KeyRow, "default" | "required" | "unit" | "holds" | "by">;
  bad: boolean;
  directions?: string[]; // the axes that the table has
  change: (value: Toml | null) => void; // null removes it
}

const NOTHING = { default: "", required: false, unit: "", holds: "", by: "" };

/** The field of a value; one that the form cannot show is a line of TOML. */
export function ValueField(props: ValueProps): JSX.Element {
  const { form, own } = props;
  if (own !== undefined && !shows(form, own)) return <TomlField {...props} />;
  return FIELDS[form.kind](props);
}

const FIELDS: Record<KeyForm["kind"], (props: ValueProps) => JSX.Element> = {
  text: TextValue,
  number: NumberValue,
  integer: NumberValue,
  flag: ChoiceValue,
  choice: ChoiceValue,
  texts: TextsValue,
  numbers: NumbersValue,
  pair: PairValue,
  table: TableValue,
  entry: EntryValue,
  entries: EntriesValue,
  named: TomlField,
  either: EitherValue,
  list: ListValue,
  toml: TomlField,
};

const box = (props: ValueProps, kind = ""): string => `field small ${kind} ${props.bad ? "bad" : ""}`;

function TextValue(props: ValueProps) {
  const { holds } = props.known;
  const few = ["variant", "group axis"].includes(holds) ? (names.value[holds] ?? []) : [];
  if (few.length)
    return (
      <ChoiceInput
        own={props.own as string | undefined}
        options={few}
        none={props.known.default || "none"}
        label={props.label}
        bad={props.bad}
        choose={(option) => props.change(option || null)}
      />
    );
  if (holds === "paragraphs")
    return (
      <span class={box(props, "wide lines")}>
        <LinesInput
          label={props.label}
          placeholder={props.known.default || "none"}
          text={props.own === undefined ? "" : String(props.own)}
          enter={(text) => props.change(text === "" ? null : text)}
        />
      </span>
    );
  const mono = ["condition", "formula"].includes(holds);
  return (
    <span class={box(props, `wide ${mono ? "mono" : ""}`)}>
      <LineInput
        label={props.label}
        holds={holds}
        placeholder={props.known.default || (props.known.required ? "" : "none")}
        text={props.own === undefined ? "" : String(props.own)}
        enter={(text) => props.change(text === "" ? null : text)}
      />
    </span>
  );
}

function NumberValue(props: ValueProps) {
  return (
    <span class={box(props, `num ${props.known.default.length > 8 ? "long" : ""}`)}>
      <NumberInput
        label={props.label}
        words={props.form.words}
        placeholder={props.known.default}
        own={props.own}
        enter={props.change}
      />
      {props.known.unit && <u>{props.known.unit}</u>}
    </span>
  );
}

function NumbersValue(props: ValueProps) {
  return (
    <span class={box(props, "wide")}>
      <NumbersInput
        label={props.label}
        words={props.form.words}
        placeholder={props.known.default || "numbers, separated by spaces"}
        own={props.own}
        enter={props.change}
      />
    </span>
  );
}

function PairValue(props: ValueProps) {
  return (
    <PairInput
      own={(props.own as Toml[] | undefined) ?? null}
      label={props.label}
      bad={props.bad}
      enter={props.change}
    />
  );
}

function ChoiceValue(props: ValueProps) {
  const isFlag = props.form.kind === "flag";
  const options = isFlag ? ["true", "false"] : (props.form.options ?? []);
  const plain = props.known.default.replaceAll('"', "");
  const standard = options.includes(plain) ? plain : undefined;
  const choose = (option: string) =>
    props.change(option === "" || option === standard ? null : isFlag ? option === "true" : option);
  return (
    <ChoiceInput
      own={props.own === undefined ? standard : String(props.own)}
      options={options}
      none={standard === undefined ? props.known.default || "none" : undefined}
      label={props.label}
      bad={props.bad}
      choose={choose}
    />
  );
}

/** Texts one below the other; the last line adds one. A few known words are buttons. */
function TextsValue(props: ValueProps) {
  const items = props.own === undefined ? [] : Array.isArray(props.own) ? props.own : [props.own];
  const read = (text: string): Toml => (props.form.numbers && /^\d+$/.test(text) ? Number(text) : text);
  const put = (next: Toml[]) =>
    props.change(next.length === 0 ? null : next.length === 1 && typeof props.own === "string" ? next[0]! : next);
  const { options } = props.form;
  if (options) {
    const all = [...options, ...items.map(String).filter((item) => !options.includes(item))];
    return (
      <span class="row wrap">
        {all.map((each) => (
          <button
            class="chip"
            aria-pressed={items.includes(each)}
            onClick={() => put(items.includes(each) ? items.filter((item) => item !== each) : [...items, each])}
          >
            {each}
          </button>
        ))}
      </span>
    );
  }
  const line = (text: string, enter: (text: string) => void, label: string, placeholder = "") => (
    <span class={box(props, "wide")}>
      <LineInput label={label} holds={props.known.holds} placeholder={placeholder} text={text} enter={enter} />
    </span>
  );
  return (
    <span class="column">
      {items.map((item, k) => (
        <span class="row">
          {line(
            String(item),
            (text) =>
              put(
                text === "" ? items.filter((_, i) => i !== k) : items.map((each, i) => (i === k ? read(text) : each)),
              ),
            `${props.label} ${k + 1}`,
          )}
          {items.length > 1 && (
            <Remove label={`${props.label} ${k + 1}`} act={() => put(items.filter((_, i) => i !== k))} />
          )}
        </span>
      ))}
      {line(
        "",
        (text) => put([...items, read(text)]),
        `Add to ${props.label}`,
        items.length
          ? `another ${props.known.holds || "one"}`
          : props.known.default || `a ${props.known.holds || "text"}`,
      )}
    </span>
  );
}

/** A table by axis, or by name with a line that adds one. */
function TableValue(props: ValueProps) {
  const table = (props.own ?? {}) as Table;
  const fixed = props.form.names ?? [];
  const shown = fixed.length
    ? fixed.filter((name) => name in table || (props.directions ?? fixed).includes(name))
    : Object.keys(table);
  const put = (name: string, value: Toml | null) => props.change(without(table, name, value));
  const inner = (name: string) => (
    <ValueField
      {...props}
      form={props.form.values!}
      own={table[name]}
      label={`${props.label} ${name}`}
      path={[...props.path, name]}
      known={{ ...NOTHING, holds: props.known.holds, by: props.known.by, unit: props.known.unit }}
      directions={props.known.by === "parameter" ? directionsOf(name) : props.directions}
      change={(value) => put(name, value)}
    />
  );
  return (
    <span class="column">
      {shown.map((name) => (
        <span class={`row part ${fixed.length ? "short" : ""}`}>
          <span class="name cut" title={name}>
            {name}
          </span>
          {inner(name)}
          {!fixed.length && <Remove label={`${props.label} ${name}`} act={() => put(name, null)} />}
        </span>
      ))}
      {!fixed.length && <AddNamed props={props} taken={shown} put={put} />}
    </span>
  );
}

const without = (table: Table, name: string, value: Toml | null): Table | null => {
  const next = { ...table };
  if (value === null) delete next[name];
  else next[name] = value;
  return Object.keys(next).length ? next : null;
};

/** A name and a value; both together are added. */
function AddNamed({
  props,
  taken,
  put,
}: {
  props: ValueProps;
  taken: string[];
  put: (name: string, value: Toml | null) => void;
}) {
  const name = useSignal("");
  const add = (value: Toml | null) => {
    if (value !== null && name.value) {
      put(name.value, value);
      name.value = "";
    }
  };
  const isTaken = taken.includes(name.value);
  return (
    <span class={`row part ${name.value && !isTaken ? "" : "lone"}`}>
      <span class={`field small name ${isTaken ? "bad" : ""}`} title={isTaken ? "is there already" : ""}>
        <LineInput
          label={`New name in ${props.label}`}
          holds={props.known.by}
          placeholder={props.known.by || "name"}
          text={name.value}
          enter={(text) => {
            name.value = text;
          }}
        />
      </span>
      {name.value && !isTaken && (
        <ValueField
          {...props}
          form={props.form.values!}
          own={undefined}
          label={`${props.label} ${name.value}`}
          path={[...props.path, name.value]}
          known={{ ...NOTHING, holds: props.known.holds, by: props.known.by, unit: props.known.unit }}
          change={add}
        />
      )}
    </span>
  );
}

/**
 * A table of keys, written once it has the required ones. One key stands alone; many are below a line that sums them
 * up.
 */
function EntryValue(props: ValueProps) {
  const [open, draft] = [useSignal(false), useSignal<Table>({})];
  const table = (props.own ?? draft.value) as Table;
  const keys = props.form.keys!;
  const put = (name: string, value: Toml | null) => {
    const next = without(table, name, value);
    const isWhole = next === null || props.own !== undefined || keys.every((key) => !key.required || key.name in next);
    draft.value = isWhole ? {} : next;
    if (isWhole) props.change(next);
  };
  if (keys.length === 1) return <KeyValue props={props} of={keys[0]!} table={table} put={put} />;
  const rows = keys.map((key) => (
    <span class="row part" data-part={`${key.name}: ${key.help}`}>
      <span class="name cut" title={key.help}>
        {key.name}
      </span>
      <KeyValue props={props} of={key} table={table} put={put} />
    </span>
  ));
  if (keys.length < 5) return <span class="column">{rows}</span>;
  return (
    <span class="column">
      <button
        class="fold"
        aria-expanded={open.value}
        onClick={() => {
          open.value = !open.value;
        }}
      >
        {open.value ? "⌄" : "›"}{" "}
        {props.own === undefined ? <span class="q">{props.known.default || "none"}</span> : brief(props.own)}
      </button>
      {open.value && rows}
    </span>
  );
}

function KeyValue({
  props,
  of,
  table,
  put,
}: {
  props: ValueProps;
  of: KeyRow;
  table: Table;
  put: (name: string, value: Toml | null) => void;
}) {
  return (
    <ValueField
      form={of.form}
      own={table[of.name]}
      label={`${props.label} ${of.name}`}
      path={[...props.path, of.name]}
      known={of}
      bad={props.bad}
      directions={props.directions}
      change={(value) => put(of.name, value)}
    />
  );
}

/** Entries one below the other. A new one is added once its required keys are filled in. */
function EntriesValue(props: ValueProps) {
  const draft = useSignal<Table | null>(null);
  const entries = (props.own === undefined ? [] : Array.isArray(props.own) ? props.own : [props.own]) as Table[];
  const keys = props.form.keys!.filter(
    (key) => !props.directions || !["x", "y", "z", "w"].includes(key.name) || props.directions.includes(key.name),
  );
  const put = (next: Table[]) =>
    props.change(
      next.length === 0
        ? null
        : next.length === 1 && props.own !== undefined && !Array.isArray(props.own)
          ? next[0]!
          : next,
    );
  const extend = (table: Table) => {
    const isWhole = keys.every((key) => !key.required || key.name in table) && Object.keys(table).length > 0;
    draft.value = isWhole ? null : table;
    if (isWhole) put([...entries, table]);
  };
  const entry = (table: Table, number: number, enter: (next: Table) => void, remove: () => void) => (
    <span class="entry">
      <span class="column">
        {keys.map((key) => (
          <span class="row part" data-part={`${key.name}: ${key.help}`}>
            <span class="name cut" title={key.help}>
              {key.name}
            </span>
            <KeyValue
              props={{ ...props, label: `${props.label} ${number}`, path: [...props.path, number] }}
              of={key}
              table={table}
              put={(name, value) => enter(without(table, name, value) ?? {})}
            />
          </span>
        ))}
      </span>
      <Remove label={`${props.label} ${number}`} act={remove} />
    </span>
  );
  return (
    <span class="column">
      {entries.map((table, k) =>
        entry(
          table,
          k + 1,
          (next) => put(entries.map((each, i) => (i === k ? next : each))),
          () => put(entries.filter((_, i) => i !== k)),
        ),
      )}
      {draft.value &&
        entry(draft.value, entries.length + 1, extend, () => {
          draft.value = null;
        })}
      {!draft.value && (
        <button
          class="btn small add"
          aria-label={`Add to ${props.label}`}
          onClick={() => {
            draft.value = {};
          }}
        >
          + {props.form.word || "entry"}
        </button>
      )}
    </span>
  );
}

/** One of several forms; the one of the value is chosen. */
function EitherValue(props: ValueProps) {
  const chosen = useSignal<number | null>(null);
  const forms = props.form.forms!;
  const present = props.own === undefined ? 0 : forms.findIndex((form) => shows(form, props.own!));
  const at = chosen.value ?? present;
  const form = forms[at]!;
  const choose = (title: string) => {
    const next = forms.findIndex((each) => each.title === title);
    chosen.value = next === present ? null : next;
    const only =
      forms[next]!.kind === "flag" ? true : forms[next]!.options?.length === 1 ? forms[next]!.options![0]! : null;
    if (only !== null && next !== present) {
      chosen.value = null;
      props.change(only);
    }
  };
  const change = (value: Toml | null) => {
    chosen.value = null;
    props.change(value);
  };
  const isDone = form.options?.length === 1;
  return (
    <span class={["table", "entries", "toml"].includes(form.kind) || (form.keys?.length ?? 0) > 1 ? "column" : "row"}>
      <ChoiceInput
        own={form.title}
        options={forms.map((each) => each.title ?? "")}
        label={`Kind of ${props.label}`}
        bad={false}
        width={78}
        choose={choose}
      />
      {!isDone && <ValueField {...props} form={form} own={at === present ? props.own : undefined} change={change} />}
    </span>
  );
}

/** A list of values of one form; a single one may stand alone in the file. */
function ListValue(props: ValueProps) {
  const adding = useSignal(false);
  const items = props.own === undefined ? [] : Array.isArray(props.own) ? props.own : [props.own];
  const put = (next: Toml[]) =>
    props.change(next.length === 0 ? null : next.length === 1 && !Array.isArray(props.own) ? next[0]! : next);
  const item = (own: Toml | undefined, k: number, change: (value: Toml | null) => void, remove: () => void) => (
    <span class="entry">
      <ValueField
        {...props}
        form={props.form.item!}
        own={own}
        label={`${props.label} ${k + 1}`}
        path={[...props.path, k + 1]}
        change={change}
      />
      {(items.length > 1 || own === undefined) && <Remove label={`${props.label} ${k + 1}`} act={remove} />}
    </span>
  );
  return (
    <span class="column">
      {items.map((own, k) =>
        item(
          own,
          k,
          (value) =>
            put(value === null ? items.filter((_, i) => i !== k) : items.map((each, i) => (i === k ? value : each))),
          () => put(items.filter((_, i) => i !== k)),
        ),
      )}
      {adding.value &&
        item(
          undefined,
          items.length,
          (value) => {
            if (value !== null) {
              adding.value = false;
              put([...items, value]);
            }
          },
          () => {
            adding.value = false;
          },
        )}
      {!adding.value && (
        <button
          class="btn small add"
          aria-label={`Add to ${props.label}`}
          onClick={() => {
            adding.value = true;
          }}
        >
          + {props.known.holds || "entry"}
        </button>
      )}
    </span>
  );
}

/** A value as one line of TOML, which the server reads; its message stays below until the line is right. */
function TomlField(props: ValueProps) {
  const refusal = useSignal("");
  const enter = async (text: string) => {
    try {
      await ask("set-toml", { path: props.path, text, title: `${props.label}: ${text.slice(0, 40) || "default"}` });
      refusal.value = "";
    } catch (error) {
      refusal.value = (error as Error).message;
    }
  };
  return (
    <span class="column">
      <span class={box({ ...props, bad: props.bad || refusal.value !== "" }, "wide mono")}>
        <LineInput
          label={`${props.label}, as TOML`}
          placeholder={props.known.default || "a value as in the project file"}
          text={props.own === undefined ? "" : asToml(props.own)}
          enter={enter}
        />
      </span>
      {refusal.value && (
        <span class="remark bad" role="alert">
          {refusal.value}
        </span>
      )}
    </span>
  );
}

export function Remove({ label, act }: { label: string; act: () => void }) {
  return (
    <button class="btn bare small remove" aria-label={`Remove ${label}`} title={`Remove ${label}`} onClick={act}>
      ×
    </button>
  );
}
