// The errors in the header: two lines, whatever the number of criteria. One criterion has a line for training and one
// for test data, two have a line each, and of more the chosen one is shown, else the one that has improved least.

import type { ScoreRow } from "./replies";

export interface Line {
  criterion: string;
  training: ScoreRow | null;
  test: ScoreRow | null;
}

/** The scores of each criterion that has samples, in the order of the project. */
export function linesOf(scores: readonly ScoreRow[]): Line[] {
  const names = [...new Set(scores.filter((each) => each.samples > 0).map((each) => each.criterion))];
  return names.map((criterion) => {
    const own = (use: string) =>
      scores.find((each) => each.criterion === criterion && each.use === use && each.samples > 0) ?? null;
    return { criterion, training: own("training"), test: own("test") };
  });
}

/** How an error has changed since the start: 1 if it has not. */
const ratio = (own: ScoreRow | null): number =>
  own === null || own.rmse === null || !own.before ? -1 : own.rmse / own.before;

/** The lines that are shown; of more than two, the chosen one alone. */
export function shownLines(lines: readonly Line[], chosen: string): Line[] {
  if (lines.length <= 2) return [...lines];
  const worst = lines.toSorted((a, b) => ratio(b.training) - ratio(a.training))[0]!;
  return [lines.find((each) => each.criterion === chosen) ?? worst];
}

/** The change of an error, 0 if only the rounding of its sum has changed. */
export const changeOf = (before: number, now: number): number =>
  Math.abs(now - before) <= 1e-12 * Math.abs(before) ? 0 : now - before;

/** How many of the others the last edit made worse, in words. */
export function othersText(lines: readonly Line[], shown: Line): string {
  const others = lines.filter((each) => each !== shown);
  const worse = others.filter(
    ({ training }) => training !== null && changeOf(training.last ?? Infinity, training.rmse ?? 0) > 0,
  );
  return `${others.length} more, ${worse.length === 0 ? "none" : worse.length} worse than before the edit`;
}

/** A name that is too long loses its middle. */
export function shortened(name: string, most: number): string {
  if (name.length <= most) return name;
  const end = Math.floor((most - 1) / 2);
  return `${name.slice(0, most - 1 - end)}…${name.slice(name.length - end)}`;
}
