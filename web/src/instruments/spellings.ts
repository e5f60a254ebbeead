// Words of formula text that messages are about, each with a known name like it.

import { computed, effect } from "@preact/signals";
import { newest } from "../connection";
import type { SpellingRow } from "../replies";
import { scoped } from "../scope";
import { settings } from "../settings";
import { request, screen, settled, state } from "../store";

export const spellings = scoped<SpellingRow[]>([]);

const load = newest(async (_: number) => {
  const reply = await request("spellings");
  if (reply !== null) spellings.value = reply.head.spellings;
});

const textRevision = computed(() => state.value.textRevision);

effect(() => {
  const revision = textRevision.value;
  if (screen.value !== "function") return;
  if (settled.value.findings.some((each) => each.screen === "function" && each.column > 0)) load(revision);
  else spellings.value = [];
});

/** Replace the word in the function. */
export function correct({ line, column, word, similar }: SpellingRow): void {
  const { file, function: text } = settings.value;
  const lines = text.split("\n");
  const own = lines[line - 1] ?? "";
  if (!own.startsWith(word, column - 1)) return;
  lines[line - 1] = own.slice(0, column - 1) + similar + own.slice(column - 1 + word.length);
  void request("set-text", { file, text: lines.join("\n"), title: `${word} is ${similar}` });
}
