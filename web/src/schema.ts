// What the project file may say: its sections and keys as Python describes them, and the names that values choose from.

import { effect, signal } from "@preact/signals";
import { newest } from "./connection";
import type { KeyForm, KeyRow, Path, SectionRow, Toml } from "./replies";
import { scoped } from "./scope";
import { textRevision } from "./settings";
import { request, settled } from "./store";

export const sections = signal<SectionRow[]>([]);
export const names = scoped<Record<string, string[]>>({});

let asked = false;

effect(() => {
  if (settled.value.project === null || asked) return;
  asked = true;
  void request("schema").then((reply) => {
    if (reply === null) asked = false;
    else sections.value = reply.head.sections;
  });
});

const loadNames = newest(async (_: number) => {
  const reply = await request("names");
  if (reply !== null) names.value = reply.head.names;
});

/** Number of forms on the screen; names are asked for while there is one. */
export const shownForms = signal(0);

effect(() => {
  if (shownForms.value > 0 && textRevision.value > 0) loadNames(textRevision.value);
});

export const sectionOf = (name: string): SectionRow | undefined => sections.value.find((each) => each.name === name);

/** The keys of an entry of a section, or of the section itself. */
export const keysOf = (name: string): KeyRow[] => sectionOf(name)?.form.keys ?? [];

/**
 * The key that a path names, or the one around it: that of `gradient` for `["parameters", "MapX", "gradient", "x"]`.
 */
export function keyAt(path: Path): KeyRow | undefined {
  const section = sectionOf(String(path[0]));
  if (section === undefined || section.form.kind === "table") return section;
  return keysOf(section.name).find((key) => key.name === path[isSingle(section) ? 1 : 2]);
}

const isSingle = (section: SectionRow): boolean => section.form.kind === "entry";

/** Name of a key without that of its entry: `parameters.bounds`. */
export function settingName(path: Path): string {
  const section = sectionOf(String(path[0]));
  if (section === undefined || path.length === 1) return String(path[0]);
  return `${path[0]}.${path[isSingle(section) || section.form.kind === "table" ? 1 : 2] ?? ""}`;
}

/** The axes of a parameter: as many of x, y, z and w as it has; undefined if it is not known. */
export function directionsOf(name: string): string[] | undefined {
  const own = settled.value.parameters.find((p) => p.name === name);
  return own && (own.kind === "scalar" ? [] : ["x", "y", "z", "w"].slice(0, own.shape.length));
}

/** True if a field of this form can show the value. */
export function shows(form: KeyForm, value: Toml): boolean {
  const isTable = typeof value === "object" && !Array.isArray(value);
  const isScalar = typeof value !== "object";
  switch (form.kind) {
    case "text":
    case "choice":
      return typeof value === "string" && (form.options === undefined || form.options.includes(value));
    case "number":
    case "integer":
      return typeof value === "number" || (typeof value === "string" && (form.words ?? []).includes(value));
    case "flag":
      return typeof value === "boolean";
    case "texts":
      return typeof value === "string" || (Array.isArray(value) && value.every((each) => typeof each !== "object"));
    case "numbers":
      return (
        typeof value === "number" ||
        (Array.isArray(value) && value.every((each) => typeof each !== "object")) ||
        (typeof value === "string" && (form.words ?? []).includes(value))
      );
    case "pair":
      return Array.isArray(value) && value.length === 2 && value.every((each) => typeof each !== "object");
    case "table":
      return (
        isTable &&
        Object.entries(value as Table).every(
          ([name, inner]) => (!form.names?.length || form.names.includes(name)) && shows(form.values!, inner),
        )
      );
    case "entry":
      return isTable && Object.keys(value as Table).every((name) => form.keys!.some((key) => key.name === name));
    case "entries":
      return Array.isArray(value)
        ? value.every((each) => typeof each === "object" && !Array.isArray(each))
        : isTable && form.single === true;
    case "either":
      return form.forms!.some((each) => shows(each, value));
    case "list":
      return (Array.isArray(value) ? value : [value]).every((each) => shows(form.item!, each));
    default:
      return !isScalar || form.kind === "toml";
  }
}

type Table = { [key: string]: Toml };

/** A value as one line of TOML. */
export function asToml(value: Toml): string {
  if (Array.isArray(value)) return `[${value.map(asElement).join(", ")}]`;
  if (typeof value === "object")
    return `{ ${Object.entries(value)
      .map(([name, inner]) => `${/^[\w-]+$/.test(name) ? name : JSON.stringify(name)} = ${asToml(inner)}`)
      .join(", ")} }`;
  return typeof value === "string" ? JSON.stringify(value) : String(value);
}

const asElement = (value: Toml): string => (value === "inf" || value === "-inf" ? value : asToml(value));

const MAIN = ["channel", "node", "hex", "parameter", "where", "input"]; // keys whose values need no name

/** A value in a few words, for the line of an entry. */
export function brief(value: Toml): string {
  if (Array.isArray(value)) return value.length <= 3 ? value.map(brief).join(", ") : `${value.length} entries`;
  if (typeof value === "object")
    return Object.entries(value)
      .map(([name, inner]) => (MAIN.includes(name) ? brief(inner) : `${name} ${brief(inner)}`))
      .join(" ");
  return String(value);
}
