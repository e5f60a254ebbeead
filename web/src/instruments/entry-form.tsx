// A form for one section or entry of the project file: a line a key, those that are set first.

import { useSignal } from "@preact/signals";
import { useEffect, useLayoutEffect, useMemo, useRef } from "preact/hooks";
import { tooltip } from "../fields";
import { wanted } from "../navigation";
import type { FindingRow, KeyRow, Path, Toml } from "../replies";
import { asToml, keysOf, sectionOf, settingName, shownForms } from "../schema";
import { messagesOf, messagesWithin, setKeys, settings, valueAt } from "../settings";
import { Fixes } from "./finding";
import { Remove, ValueField } from "./value-field";

type Table = { [key: string]: Toml };

interface FormProps {
  path: Path;
  skip?: string[]; // keys that stand elsewhere on the screen
  main?: string[]; // keys that are shown with those that are set
  directions?: string[]; // the axes that the table has
  draft?: { own: Table; change: (next: Table) => void }; // an entry that is not in the file yet
}

/** The fields of an entry at a path, such as `["dataset", 1]` or `["optimizer"]`. */
export function EntryForm({ path, skip = [], main = [], directions, draft }: FormProps) {
  const section = String(path[0]);
  const own = (draft?.own ?? valueAt(path) ?? {}) as Table;
  const strays = Object.keys(own)
    .filter((name) => !keysOf(section).some((key) => key.name === name))
    .map(unknownKey);
  const all = [...keysOf(section), ...strays].filter(
    (key) =>
      !skip.includes(key.name) &&
      !(directions && ["x", "y", "z", "w"].includes(key.name) && !directions.includes(key.name) && !(key.name in own)),
  );
  const [whole, focused, part] = [useSignal(false), useSignal(""), useSignal("")];
  const host = useRef<HTMLDivElement>(null);
  useEffect(() => {
    shownForms.value += 1;
    return () => {
      shownForms.value -= 1;
    };
  }, []);
  const set = useMemo(
    () => all.filter((key) => key.name in own || key.required || main.includes(key.name)).map((key) => key.name),
    [path.join("\n"), all.length, settings.value.text === ""],
  );
  const upper = all.filter((key) => set.includes(key.name));
  const rest = all.filter((key) => !set.includes(key.name));
  const isOpen = whole.value || upper.length === 0 || draft !== undefined;
  const [name, key] = wanted.value.split(".");
  useLayoutEffect(() => {
    if (name !== section || !all.some((each) => each.name === key)) return;
    if (!isOpen && rest.some((each) => each.name === key)) whole.value = true;
    else if (focusSetting(host.current, wanted.value)) wanted.value = "";
  });
  const change = (key: KeyRow, value: Toml | null) => {
    if (draft === undefined)
      void setKeys(
        [[[...path, key.name], value]],
        `${settingName([...path, key.name])}: ${value === null ? "default" : typeof value === "string" ? value : asToml(value).slice(0, 60)}`,
      );
    else {
      const next = { ...own };
      if (value === null) delete next[key.name];
      else next[key.name] = value;
      draft.change(next);
    }
  };
  const row = (key: KeyRow) => (
    <Setting
      key={key.name}
      path={[...path, key.name]}
      of={key}
      own={own[key.name]}
      directions={directions}
      help={focused.value === key.name ? part.value || key.help : ""}
      change={(value) => change(key, value)}
    />
  );
  const general = messagesOf(path);
  return (
    <div
      class="settings"
      ref={host}
      role="group"
      aria-label={path.join(" ")}
      onFocusIn={(event) => {
        const at = event.target as HTMLElement;
        focused.value = at.closest<HTMLElement>("[data-key]")?.dataset.key ?? "";
        part.value = at.closest<HTMLElement>("[data-part]")?.dataset.part ?? "";
      }}
    >
      {general.map((f) => (
        <Remark key={f.message} own={f} />
      ))}
      {upper.map(row)}
      {upper.length > 0 && rest.length > 0 && draft === undefined && (
        <button
          class="fold more"
          aria-expanded={whole.value}
          onClick={() => {
            whole.value = !whole.value;
          }}
        >
          {whole.value ? "⌄" : "›"} all settings ({rest.length})
        </button>
      )}
      {isOpen && rest.map(row)}
    </div>
  );
}

/** A key that the schema does not have, which may be removed or corrected. */
const unknownKey = (name: string): KeyRow => ({
  name,
  help: "not a key of this section",
  type: "",
  default: "",
  required: false,
  unit: "",
  holds: "",
  by: "",
  form: { kind: "toml" },
});

/** Put the cursor into the field of a key; false if it is not on the page yet. */
export function focusSetting(host: Element | null, name: string): boolean {
  const row = host?.querySelector(`[data-setting="${name}"]`);
  const field = row?.querySelector<HTMLElement>("input, textarea, select, button");
  if (!field) return false;
  row!.scrollIntoView({ block: "center" });
  field.focus();
  return true;
}

function Setting({
  path,
  of,
  own,
  directions,
  help,
  change,
}: {
  path: Path;
  of: KeyRow;
  own: Toml | undefined;
  directions?: string[];
  help: string;
  change: (value: Toml | null) => void;
}) {
  const messages = messagesWithin(path, of);
  const facts = [of.type, of.default && `default: ${of.default}`].filter(Boolean).join(" · ");
  return (
    <div
      class={`setting ${own === undefined ? "" : "set"}`}
      data-key={of.name}
      data-setting={settingName(path)}
      role="group"
      aria-label={of.name}
      title={tooltip(path, of)}
    >
      <span class="label cut">
        {of.name}
        {of.required && own === undefined && (
          <span class="bad" title="required">
            {" "}
            *
          </span>
        )}
      </span>
      <ValueField
        form={of.form}
        own={own}
        label={settingName(path)}
        path={path}
        known={of}
        bad={messages.some((f) => f.severity === "error")}
        directions={directions}
        change={change}
      />
      {own === undefined || of.required ? (
        <span />
      ) : (
        <Remove label={`${settingName(path)}, back to the default`} act={() => change(null)} />
      )}
      {help && (
        <p class="help">
          {help}
          {help === of.help && facts && <span class="q"> ({facts})</span>}
        </p>
      )}
      {messages.map((f) => (
        <Remark key={f.message} own={f} />
      ))}
    </div>
  );
}

/** A message below its field, with its fixes. */
function Remark({ own }: { own: FindingRow }) {
  return (
    <p class={`remark ${own.severity === "error" ? "bad" : "warn"}`} role="alert">
      {own.message} <Fixes own={own} />
    </p>
  );
}

/** The entries of a table that differ, as the history says it. */
function changeOf(section: string, before: Table, after: Table): string {
  const names = [...new Set([...Object.keys(before), ...Object.keys(after)])].filter(
    (name) => before[name] !== after[name],
  );
  return names.map((name) => `${section}.${name}: ${after[name] ?? "removed"}`).join(", ");
}

/** A section that is a table by name: calculated channels, units, surrogates. */
export function TableForm({ section }: { section: string }) {
  const known = sectionOf(section);
  const host = useRef<HTMLDivElement>(null);
  useEffect(() => {
    shownForms.value += 1;
    return () => {
      shownForms.value -= 1;
    };
  }, []);
  const isWanted = wanted.value === section;
  useLayoutEffect(() => {
    if (isWanted && focusSetting(host.current, section)) wanted.value = "";
  });
  if (known === undefined) return null;
  const messages = messagesWithin([section]);
  return (
    <div class="settings" ref={host} role="group" aria-label={section}>
      <p class="help">{known.help}</p>
      <div class="setting whole" data-setting={section}>
        <ValueField
          form={known.form}
          own={valueAt([section])}
          label={section}
          path={[section]}
          known={known}
          bad={messages.some((f) => f.severity === "error")}
          change={(value) =>
            setKeys(
              [[[section], value]],
              changeOf(section, (valueAt([section]) ?? {}) as Table, (value ?? {}) as Table),
            )
          }
        />
      </div>
      {messages.map((f) => (
        <Remark key={f.message} own={f} />
      ))}
    </div>
  );
}
