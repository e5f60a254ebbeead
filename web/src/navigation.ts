// Where settings are shown: the open panel of each screen, the open entry of each section, and the jump to a key.

import { signal } from "@preact/signals";
import type { FindingRow, KeyRow, Path } from "./replies";
import { keysOf, sectionOf, sections } from "./schema";
import { scoped } from "./scope";
import { valueAt } from "./settings";
import { open, openName, screen, state } from "./store";

/** The section whose settings a screen shows, empty if none. */
export const panel = { data: signal(""), parameters: signal(""), function: signal("") };

const FIRST = { data: "dataset", parameters: "parameters", function: "model" };

/** Open or close the settings of the present screen. */
export function togglePanel(): void {
  const name = screen.value as keyof typeof panel;
  panel[name].value = panel[name].value ? "" : FIRST[name];
}

/** The open entry of a section: its number, or its name; 0 if none is open. */
export const opened = scoped<Record<string, number | string>>({ dataset: 1 });

/** The key that a jump is to show; the form that has it takes the focus. */
export const wanted = scoped("");

export function openEntry(section: string, entry: number | string): void {
  opened.value = { ...opened.value, [section]: entry };
}

/** The path of the open entry of a section, or of the section; null if it has no entry. */
export function entryPath(section: string): Path | null {
  const { form } = sectionOf(section)!;
  if (form.kind === "entry" || form.kind === "table") return [section];
  if (section === "parameters") return openName.value ? [section, openName.value] : null;
  const entries = valueAt([section]);
  if (entries === undefined) return null;
  const known = Array.isArray(entries) ? entries.map((_, k) => k + 1) : Object.keys(entries);
  const own = opened.value[section];
  return known.length === 0 ? null : [section, known.find((each) => each === own) ?? known[0]!];
}

/** Show a key of a section, of its open entry or its first one, and put the cursor into its field. */
export function jump(section: string, key: string): void {
  const known = sectionOf(section);
  if (known === undefined) return;
  screen.value = known.screen;
  if (known.screen in panel) panel[known.screen as keyof typeof panel].value = section;
  const path = entryPath(section);
  if (path !== null && path.length === 2) openEntry(section, path[1]!);
  wanted.value = key ? `${section}.${key}` : section;
}

const PLACES = [/^\[\[(\w+)\]\] ?(\d*) ?(\w*)/, /^\[(\w+)\.(.+?)\] ?(\w*)/, /^\[(\w+)\]() ?(\w*)/];

/** Show the field that a message is about, or its screen. */
export function showFinding(finding: FindingRow): void {
  const place = PLACES.map((pattern) => pattern.exec(finding.path)).find((match) => match !== null);
  const [section, entry, part] = [place?.[1] ?? "", place?.[2] ?? "", place?.[3] ?? ""];
  const key = keysOf(section).find((each) => each.name === part || (part && each.form.word === part))?.name ?? "";
  screen.value = finding.screen;
  if (sectionOf(section) === undefined) return;
  if (section === "parameters" && state.value.parameters.some((p) => p.name === entry)) open(entry);
  else if (entry) openEntry(section, /^\d+$/.test(entry) ? Number(entry) : entry);
  jump(section, key);
}

/** Every key with its section, in the order of the documentation. */
export function allKeys(): { section: string; key: KeyRow }[] {
  return sections.value.flatMap((section) => [
    { section: section.name, key: { ...section, name: "" } },
    ...(section.form.keys ?? []).map((key) => ({ section: section.name, key })),
  ]);
}
