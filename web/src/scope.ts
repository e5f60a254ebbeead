// What belongs to the open project: every signal that holds an answer or a choice about it. When another project is
// opened, all of them take their first values again, so that nothing of one project is ever shown in another.

import { batch, type Signal, signal } from "@preact/signals";

let project = "";
const renewals: (() => void)[] = [];

/** Return the id of the project that the page shows; empty if none is open. */
export const projectId = (): string => project;

/** Make a signal that takes its first value again when another project is opened. */
export function scoped<T>(first: T): Signal<T> {
  const own = signal(first);
  renewals.push(() => {
    own.value = first;
  });
  return own;
}

/** Call a function when another project is opened, to forget what is kept beside signals. */
export function onRenewal(forget: () => void): void {
  renewals.push(forget);
}

/** Show another project: everything that belongs to the one before is forgotten. */
export function renew(id: string): void {
  if (id === project) return;
  project = id;
  batch(() => {
    for (const each of renewals) each();
  });
}
