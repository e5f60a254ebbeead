// What each node of the function reads, for the screens that draw it.

import { computed, effect } from "@preact/signals";
import { newest } from "./connection";
import type { FunctionFlow } from "./replies";
import { scoped } from "./scope";
import { request, settled, state } from "./store";

export const flow = scoped<FunctionFlow | null>(null);

const load = newest(async (_: number) => {
  const reply = await request("flow");
  if (reply !== null) flow.value = reply.head;
});
const textRevision = computed(() => state.value.textRevision);
const hasNodes = computed(() => settled.value.nodes.length > 0);

/** Ask for the flow while something is drawn that needs it: now, and whenever the text changes. */
export function loadFlowIf(isDrawn: () => boolean): void {
  effect(() => {
    const revision = textRevision.value;
    if (isDrawn() && hasNodes.value) load(revision);
  });
}
