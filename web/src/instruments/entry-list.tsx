// The entries of a section, by number or by name: add, remove, open, each with its settings in a line.

import { useSignal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { Icon } from "../icons";
import { LineInput } from "../inputs";
import { openEntry, opened, wanted } from "../navigation";
import type { Toml } from "../replies";
import { brief, keysOf, sectionOf } from "../schema";
import { describePath, messagesOf, messagesWithin, setKeys, valueAt } from "../settings";
import { settled } from "../store";
import { EntryForm } from "./entry-form";
import { Remove } from "./value-field";

type Table = { [key: string]: Toml };

interface ListProps {
  section: string;
  noun: string; // what an entry is called
  empty: string; // what to say without entries
  title?: string; // of a head with the button that adds one
  sub?: string;
  ordered?: boolean; // entries can be moved
  oneOf?: string[]; // keys of which an entry needs one at least
  line?: (entry: number, table: Table) => ComponentChildren; // further fields of an entry's line
}

/** A list of the entries of an array of tables, `[[criterion]]`, or of named tables, `[axes.NAME]`. */
export function EntryList({ section, noun, empty, title, sub, ordered, oneOf = [], line }: ListProps) {
  const draft = useSignal<Table | null>(null);
  const sent = useSignal(0); // the number of the draft once it is written
  const isNamed = sectionOf(section)?.form.kind === "named";
  const value = valueAt([section]);
  const entries: [number | string, Table][] = Array.isArray(value)
    ? value.map((table, k) => [k + 1, table as Table])
    : Object.entries((value ?? {}) as Table).map(([name, table]) => [name, table as Table]);
  const required = keysOf(section)
    .filter((key) => key.required)
    .map((key) => key.name);
  const isWanted = wanted.value.startsWith(`${section}.`);
  const host = useRef<HTMLDivElement>(null);
  useLayoutEffect(() => {
    if (!isWanted || entries.length > 0 || draft.value !== null) return;
    if (!isNamed) draft.value = {};
    else {
      host.current?.querySelector<HTMLElement>(".add-name input")?.focus();
      wanted.value = "";
    }
  });
  const needed = [...required, ...(oneOf.length ? [oneOf.join(" or ")] : [])].join(" and ");
  const general = settled.value.findings.filter((f) => f.path === sectionOf(section)?.heading);
  const extend = (table: Table) => {
    draft.value = table;
    const hasOne = oneOf.length === 0 || oneOf.some((name) => name in table);
    if (!required.every((name) => name in table) || !hasOne || Object.keys(table).length === 0) return;
    sent.value = sent.value || entries.length + 1;
    openEntry(section, sent.value);
    void setKeys([[[section, sent.value], table]], `Added ${noun} ${sent.value}`).then((taken) => {
      if (!taken) sent.value = 0;
    });
  };
  // the draft stays until the entry is there to take its place, and Tab has moved the cursor within it
  useEffect(() => {
    if (sent.value === 0 || entries.length < sent.value) return;
    const field = document.activeElement?.closest<HTMLElement>("[data-key]");
    if (field && host.current?.contains(field)) wanted.value = `${section}.${field.dataset.key}`;
    draft.value = null;
    sent.value = 0;
  });
  const remove = (entry: number | string) => {
    openEntry(section, 0);
    void setKeys([[[section, entry], null]], `Removed ${noun} ${entry}`);
  };
  const moveUp = (entry: number) => {
    const tables = entries.map(([, table]) => table);
    tables.splice(entry - 2, 2, tables[entry - 1]!, tables[entry - 2]!);
    openEntry(section, 0);
    void setKeys([[[section], tables]], `Moved ${noun} ${entry} up`);
  };
  return (
    <div class="entries" data-section={section} ref={host}>
      {title && (
        <div class="head mid">
          <h2>{title}</h2>
          <span class="sub">{entries.length > 1 ? entries.length : sub}</span>
          <span class="right">
            <AddButton
              section={section}
              noun={noun}
              disabled={draft.value !== null}
              add={() => {
                draft.value = {};
              }}
            />
          </span>
        </div>
      )}
      {general.map((f) => (
        <p class={`remark ${f.severity === "error" ? "bad" : "warn"}`} role="alert">
          {f.message}
        </p>
      ))}
      {entries.map(([entry, table]) => {
        const isOpen = opened.value[section] === entry;
        const bad = [...messagesWithin([section, entry]), ...messagesOf([section, entry])].some(
          (f) => f.severity === "error",
        );
        return (
          <>
            <div class={`entry-line ${isOpen ? "on" : ""}`} data-entry={entry}>
              <button
                class="fold grow cut"
                aria-expanded={isOpen}
                title={describePath([section, entry])}
                onClick={() => openEntry(section, isOpen ? 0 : entry)}
              >
                <i>{isOpen ? "⌄" : "›"}</i>{" "}
                <Summary entry={entry} table={table} section={section} skip={line !== undefined} />
                {bad && <span class="tag b">error</span>}
              </button>
              {typeof entry === "number" && line?.(entry, table)}
              {ordered && entry !== 1 && (
                <button
                  class="btn bare small remove"
                  aria-label={`Move ${noun} ${entry} up`}
                  title={`Move ${noun} ${entry} up`}
                  onClick={() => moveUp(entry as number)}
                >
                  ↑
                </button>
              )}
              <Remove label={`${noun} ${entry}`} act={() => remove(entry)} />
            </div>
            {isOpen && sent.value !== entry && <EntryForm path={[section, entry]} main={oneOf} />}
          </>
        );
      })}
      {entries.length === 0 && draft.value === null && <p class="note-line q">{empty}</p>}
      {draft.value && (
        <div class="draft">
          <div class="entry-line on">
            <b class="grow">New {noun}</b>
            <span class="q">{needed ? `needs ${needed}` : "set a key"}</span>
            <Remove
              label={`new ${noun}`}
              act={() => {
                draft.value = null;
              }}
            />
          </div>
          <EntryForm
            path={[section, sent.value || entries.length + 1]}
            main={oneOf}
            draft={{ own: draft.value, change: extend }}
          />
        </div>
      )}
      {isNamed ? (
        <AddByName
          noun={noun}
          taken={entries.map(([name]) => String(name))}
          add={(name) => {
            openEntry(section, name);
            void setKeys([[[section, name], {}]], `Added ${noun} ${name}`);
          }}
        />
      ) : (
        !title &&
        draft.value === null && (
          <AddButton
            section={section}
            noun={noun}
            add={() => {
              draft.value = {};
            }}
          />
        )
      )}
    </div>
  );
}

function AddButton({
  section,
  noun,
  disabled,
  add,
}: {
  section: string;
  noun: string;
  disabled?: boolean;
  add: () => void;
}) {
  return (
    <button class="btn small add" data-add={section} disabled={disabled} onClick={add}>
      <Icon name="plus" />
      {noun[0]!.toUpperCase() + noun.slice(1)}
    </button>
  );
}

/** An entry in a few words: what it is about first. */
function Summary({
  entry,
  table,
  section,
  skip,
}: {
  entry: number | string;
  table: Table;
  section: string;
  skip: boolean;
}) {
  const parts = keysOf(section)
    .filter((key) => key.name in table)
    .map((key) => ({
      name: key.name,
      text: brief(table[key.name]!),
      isMain: key.required || ["name", "where", "input"].includes(key.name),
    }));
  const title =
    typeof entry === "string"
      ? entry
      : ((parts.find((part) => part.name === "name") ?? parts.find((part) => part.isMain))?.text ?? `${entry}`);
  const others = parts.filter((part) => part.text !== title && (!skip || part.isMain));
  return (
    <>
      <b>{title}</b>{" "}
      <span class="q">{others.map((part) => (part.isMain ? part.text : `${part.name} ${part.text}`)).join(" · ")}</span>
    </>
  );
}

/** A name and a button that adds an entry of this name. */
export function AddByName({
  noun,
  taken,
  add,
  holds,
}: {
  noun: string;
  taken: string[];
  add: (name: string) => void;
  holds?: string;
}) {
  const isTaken = useSignal(false);
  const enter = (name: string) => {
    isTaken.value = taken.includes(name);
    if (name && !isTaken.value) add(name);
  };
  return (
    <span
      class={`field small add-name ${isTaken.value ? "bad" : ""}`}
      title={isTaken.value ? "is there already" : `Name of a new ${noun}`}
    >
      <LineInput label={`Name of a new ${noun}`} holds={holds} placeholder={`+ ${noun}: name`} text="" enter={enter} />
    </span>
  );
}
