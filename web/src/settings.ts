// The settings of the project: what the project file says, and how a field changes it.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "./connection";
import { message, request, state } from "./store";

export type Toml = string | number | boolean | Toml[] | { [key: string]: Toml };
export type Path = (string | number)[]; // entries of a list count from 1

interface Settings { settings: { [key: string]: Toml }; text: string; file: string; function: string }

export const settings = signal<Settings>({ settings: {}, text: "", file: "", function: "" });

const load = newest(async (_: number) => {
  const reply = await request("settings");
  if (reply !== null) settings.value = reply.head as unknown as Settings;
});

const textRevision = computed(() => state.value.textRevision);

effect(() => {
  if (textRevision.value > 0) load(textRevision.value);
});

/** The value at a path, undefined if the project file has none. */
export function valueAt(path: Path): Toml | undefined {
  let value: Toml | undefined = settings.value.settings;
  for (const key of path) {
    if (typeof key === "number") value = Array.isArray(value) ? value[key - 1] : undefined;
    else value = typeof value === "object" && !Array.isArray(value) ? value[key] : undefined;
  }
  return value;
}

export type Change = [Path, Toml | null];

/** Set keys of the project file; null removes one. */
export async function setKeys(changes: Change[], title: string): Promise<void> {
  message.value = title;
  await request("set-keys", { changes, title });
}

/** A path as messages and the documentation write it: `[model] step`. */
export function describePath(path: Path): string {
  const [section, ...rest] = path;
  if (typeof rest[0] === "number") return `[[${section}]] ${rest.join(" ")}`;
  if (["parameters", "axes"].includes(String(section)) && rest.length) return `[${section}.${rest[0]}] ${rest.slice(1).join(" ")}`;
  return `[${section}] ${rest.join(" ")}`.trim();
}

/** The messages about a key, or about anything within it. */
export const messagesOf = (path: Path) => computed(() => state.value.findings.filter((f) => f.path === describePath(path)));
