// Ticks of lists: sets that are replaced, as signals tell a new set only.

/** A set with an item that it lacks, or without one that it has. */
export function flipped<T>(set: ReadonlySet<T>, item: T): Set<T> {
  const next = new Set(set);
  if (!next.delete(item)) next.add(item);
  return next;
}
