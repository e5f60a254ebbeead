// The keys of the project file after changes that the server has not answered yet. Pure functions.

import type { Path, Toml } from "./replies";

/** A key and its value; null removes it. */
export type Change = [Path, Toml | null];
type Table = { [key: string]: Toml };

/** Return the keys after changes; what cannot be changed so, the server says. */
export const changed = (settings: Table, changes: readonly Change[]): Table =>
  changes.reduce<Table>((keys, [path, value]) => (path.length ? (within(keys, path, value) as Table) : keys), settings);

function within(own: Toml | undefined, [key, ...rest]: Path, value: Toml | null): Toml {
  return typeof key === "number" ? inList(own, key, rest, value) : inTable(own, key!, rest, value);
}

function inTable(own: Toml | undefined, key: string, rest: Path, value: Toml | null): Toml {
  const table: Table = typeof own === "object" && !Array.isArray(own) ? { ...own } : {};
  if (rest.length > 0) {
    // nothing is removed from what is not there
    if (value !== null || key in table) table[key] = within(table[key], rest, value);
  } else if (value === null) delete table[key];
  else table[key] = value;
  return table;
}

/** Entries of lists are counted from 1; the number after the last one appends to it. */
function inList(own: Toml | undefined, number: number, rest: Path, value: Toml | null): Toml {
  const list = Array.isArray(own) ? own.slice() : [];
  if (number > list.length + (value === null ? 0 : 1)) return list;
  if (rest.length > 0) list[number - 1] = within(list[number - 1], rest, value);
  else if (value === null) list.splice(number - 1, 1);
  else list[number - 1] = value;
  return list;
}
