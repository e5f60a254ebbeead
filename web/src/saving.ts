// Saving, and the question what becomes of files that another program has changed since they were read.

import { signal } from "@preact/signals";
import type { Conflict } from "./replies";
import { message, request } from "./store";

export const conflicts = signal<Conflict[]>([]);

/** Write what was edited; files that another program has changed are shown first, unless they are to be replaced. */
export async function save(force = false): Promise<void> {
  const reply = await request("save", { force });
  if (reply === null) return;
  conflicts.value = reply.head.conflicts ?? [];
  if (conflicts.value.length === 0 && force) message.value = "Saved";
}

/** Take what is on disk over; Undo brings the edits back. */
export async function takeDisk(): Promise<void> {
  conflicts.value = [];
  await request("reload");
}
