// Missing terms: what takes part in a search, what it has found, and which proposal is shown.

import { computed, effect } from "@preact/signals";
import { newest, type Reply } from "./connection";
import { flipped } from "./flipped";
import type { MissingTerms, PlaceRow, TermRow } from "./replies";
import { scoped } from "./scope";
import { message, request, screen, settled, state } from "./store";

export type Kind = TermRow["kind"];
export type Order = "held out" | "training" | "few values";

export const terms = scoped<MissingTerms | null>(null);
/** What does not take part, by name. */
export const omitted = {
  channels: scoped<ReadonlySet<string>>(new Set()),
  nodes: scoped<ReadonlySet<string>>(new Set()),
  kinds: scoped<ReadonlySet<string>>(new Set()),
};
export const least = scoped(0);
export const order = scoped<Order>("held out");
/** The proposal that is shown, and an equal place at which it would be applied; null for the best one. */
export const chosen = scoped(0);
export const place = scoped<number | null>(null);
export const shownTerm = scoped<Reply<"term"> | null>(null);

export const looking = computed(() => state.value.terms.state === "running");
export const outcome = computed(() => terms.value?.found ?? null);
export const proposal = computed<TermRow | null>(() => outcome.value?.proposals[chosen.value] ?? null);
/** The place of the term, if it is not the best one. */
export const otherPlace = computed<PlaceRow | null>(() =>
  place.value === null ? null : (proposal.value?.places.find((each) => each.number === place.value) ?? null),
);

const SIZES: Record<Order, (own: TermRow) => number> = {
  "held out": (own) => own.heldOut.after ?? Infinity,
  training: (own) => own.training.after ?? Infinity,
  "few values": (own) => own.values,
};

/** Numbers of the proposals, in the chosen order. */
export const ordered = computed(() => {
  const rows = outcome.value?.proposals ?? [];
  const size = SIZES[order.value];
  return rows.map((_, k) => k).toSorted((a, b) => size(rows[a]!) - size(rows[b]!));
});

const load = newest(async (_: string) => {
  const reply = await request("missing");
  if (reply === null) return;
  terms.value = reply.head;
  if (chosen.value >= (reply.head.found?.proposals.length ?? 0)) choose(0);
});

const evaluable = computed(
  () => settled.value.project !== null && settled.value.parameters.length > 0 && settled.value.criteria.length > 0,
);
const isShown = computed(() => screen.value === "missing" && evaluable.value);
/** Changes with all that the screen shows of a search. */
const searchKey = computed(() => {
  const { state: own, detail, done } = state.value.terms;
  return `${own} ${detail} ${done}`;
});

effect(() => {
  const { revision } = settled.value;
  if (isShown.value) load(`${revision} ${searchKey.value}`);
});

const loadTerm = newest(async (given: { number: number; place: number | null }) => {
  const reply = await request("term", given);
  if (reply !== null) shownTerm.value = reply;
});

effect(() => {
  const own = proposal.value;
  if (isShown.value && own !== null) loadTerm({ number: chosen.value, place: place.value });
  else shownTerm.value = null;
});

export function choose(number: number): void {
  chosen.value = number;
  place.value = null;
}

/** Choose the proposal before or after, in the order of the list. */
export function step(by: number): void {
  const at = ordered.value.indexOf(chosen.value) + by;
  const next = ordered.value[at];
  if (next !== undefined) choose(next);
}

/** Let a channel, node or kind take part, or leave it out. */
export function flip(list: keyof typeof omitted, name: string): void {
  omitted[list].value = flipped(omitted[list].value, name);
}

/** The names that take part; null for all. */
function taken(list: keyof typeof omitted, names: readonly string[]): string[] | null {
  const kept = names.filter((name) => !omitted[list].value.has(name));
  return kept.length === names.length ? null : kept;
}

/** Why nothing can be looked for; empty if it can. */
export const hindrance = computed(() => {
  const own = terms.value;
  if (own === null) return "";
  if (own.kinds.every((kind) => kind.places === 0 || omitted.kinds.value.has(kind.name)))
    return "Choose a kind of term first";
  return own.nodes.every((name) => omitted.nodes.value.has(name)) ? "Choose a node first" : "";
});

export async function look(): Promise<void> {
  const own = terms.value;
  if (own === null || looking.value || hindrance.value) return;
  const usable = own.channels.filter((each) => each.reason === "").map((each) => each.name);
  choose(0);
  await request("look", {
    channels: taken("channels", usable),
    nodes: taken("nodes", own.nodes),
    kinds: taken(
      "kinds",
      own.kinds.map((each) => each.name),
    ) as Kind[] | null,
    least: least.value,
  });
}

/** Why the shown proposal cannot be applied; empty if it can. */
export const unapplied = computed(() => {
  if (outcome.value === null || proposal.value === null) return "no proposal";
  if (looking.value) return "The search is running";
  if (outcome.value.old) return "Older than the values: look again first";
  return shownTerm.value?.head.reason ?? "";
});

/** Write the shown proposal into the formula and the project; true if it was. */
export async function apply(): Promise<boolean> {
  if (unapplied.value !== "" || shownTerm.value === null) return false;
  const reply = await request("apply-term", { number: chosen.value, place: place.value });
  if (reply !== null) message.value = reply.head.title;
  return reply !== null;
}
