// Saving, and the question what becomes of files that another program has changed since they were read.

import type { Conflict } from "./replies";
import { scoped } from "./scope";
import { message, request } from "./store";

export const conflicts = scoped<Conflict[]>([]);

/**
 * Write what was edited; files that another program has changed are shown first, unless they are to be replaced. Return
 * true if it is written.
 */
export async function save(force = false): Promise<boolean> {
  const reply = await request("save", { force });
  if (reply === null) return false;
  conflicts.value = reply.head.conflicts ?? [];
  if (conflicts.value.length === 0 && force) message.value = "Saved";
  return conflicts.value.length === 0;
}

/** Take what is on disk over; Undo brings the edits back. */
export async function takeDisk(): Promise<void> {
  conflicts.value = [];
  await request("reload");
}
