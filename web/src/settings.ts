// The settings of the project: what the project file says, and how a field changes it.

import { computed, effect } from "@preact/signals";
import { type Change, changed } from "./changed-keys";
import { newest } from "./connection";
import type { FindingRow, KeyRow, Path, SettingsReply, Toml } from "./replies";
import { onRenewal, scoped } from "./scope";
import { message, request, settled, state } from "./store";

export const settings = scoped<SettingsReply>({ settings: {}, text: "", file: "", function: "" });

const load = newest(async (_: number) => {
  const reply = await request("settings");
  // answers come in the order of the questions: changes that are not answered yet are not in it
  if (reply !== null) settings.value = { ...reply.head, settings: changed(reply.head.settings, unanswered.flat()) };
});

let unanswered: Change[][] = [];
onRenewal(() => {
  unanswered = [];
});

export const textRevision = computed(() => state.value.textRevision);

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

/**
 * Set keys of the project file; null removes one. They are shown at once, so that what is entered next starts from them.
 * Returns false if they are refused.
 */
export async function setKeys(changes: Change[], title: string): Promise<boolean> {
  message.value = title;
  unanswered.push(changes);
  settings.value = { ...settings.value, settings: changed(settings.value.settings, changes) };
  const taken = (await request("set-keys", { changes, title })) !== null;
  unanswered = unanswered.filter((each) => each !== changes);
  if (!taken) load(textRevision.peek()); // show what is there
  return taken;
}

/** A path as messages and the documentation write it: `[model] step`. */
export function describePath(path: Path): string {
  const [section, ...rest] = path;
  if (typeof rest[0] === "number") return `[[${section}]] ${rest.join(" ")}`;
  if (["parameters", "axes"].includes(String(section)) && rest.length)
    return `[${section}.${rest[0]}] ${rest.slice(1).join(" ")}`.trim();
  return `[${section}] ${rest.join(" ")}`.trim();
}

/**
 * The messages about a key, or about anything within it; messages call the entries of a list by a word of their own.
 */
export function messagesWithin(path: Path, key?: KeyRow): FindingRow[] {
  const whole = describePath(path);
  const word = key?.form.word;
  const paths = word ? [whole, `${describePath(path.slice(0, -1))} ${word}`] : [whole];
  return settled.value.findings.filter((f) => paths.some((each) => f.path === each || f.path.startsWith(`${each} `)));
}

/**
 * The messages about a section or an entry itself, not about one of its keys; those about a dataset's files belong to
 * it.
 */
export function messagesOf(path: Path): FindingRow[] {
  const files = path[0] === "dataset" && path.length === 2 ? patternsOf(valueAt([...path, "files"])) : [];
  return settled.value.findings.filter(
    (f) => f.path === describePath(path) || files.some((pattern) => pattern.test(f.file)),
  );
}

function patternsOf(files: Toml | undefined): RegExp[] {
  const names = (Array.isArray(files) ? files : [files ?? ""]).map(
    (file) => String(file).split("#")[0]!.split("/").at(-1)!,
  );
  return names.filter(Boolean).map(
    (name) =>
      new RegExp(
        `^${name
          .replace(/[.+^${}()|[\]\\]/g, "\\$&")
          .replace(/\*/g, ".*")
          .replace(/\?/g, ".")}$`,
      ),
  );
}
