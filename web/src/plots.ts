// What the plots look at: dataset, criterion, stretch of time, cursor, and the samples that are brushed or shown alone.

import { batch, computed, signal } from "@preact/signals";
import type { SignalName, SignalRange } from "./replies";
import { onRenewal, scoped } from "./scope";
import { settled } from "./store";

export interface Stretch {
  begin: number;
  end: number;
}

/** Samples that are selected: a stretch of time, those within ranges of signals, or those that inform a grid point. */
export type Brush = Stretch | { ranges: SignalRange[] } | { point: { parameter: string; value: number } };

export const datasetNumber = scoped(0);
export const stretch = scoped<Stretch | null>(null); // null is the whole dataset
export const brush = scoped<Brush | null>(null);
export const only = scoped<Brush | null>(null); // all plots show these samples alone
export const range = scoped<Stretch | null>(null);
export const cursor = scoped<number | null>(null); // of a click or a key; it stays
export const hover = scoped<number | null>(null); // under the mouse
export const width = signal(800);
export const tool = signal<"zoom" | "range" | "brush">("zoom");
export const part = signal<"point" | "sample" | "range">("point"); // the pane at the lower right

const chosenCriterion = scoped(0);

export const dataset = computed(
  () => settled.value.datasets[Math.min(datasetNumber.value, settled.value.datasets.length - 1)],
);
export const criterionNumber = computed(() =>
  Math.max(0, Math.min(chosenCriterion.value, settled.value.criteria.length - 1)),
);
export const criterion = computed(() => settled.value.criteria[criterionNumber.value]);

export const visible = computed<Stretch>(() => {
  const own = dataset.value;
  return stretch.value ?? { begin: own?.begin ?? 0, end: own?.end ?? 1 };
});

export const unitOfTime = computed(() => (dataset.value?.timed ? "s" : ""));

/** The decimals of times in a stretch of some length; numbers of points have none. */
export const decimalsOfTime = (length: number): number => (dataset.value?.timed ? (length > 20 ? 1 : 3) : 0);

export function chooseCriterion(number: number): void {
  chosenCriterion.value = number;
}

/** The key of a signal, for lists and comparisons. */
export const keyOf = (own: SignalName): string => `${own.kind}:${own.name}`;

export const isStretch = (own: Brush | null): own is Stretch => own !== null && "begin" in own;

/** Show another dataset; ranges of signals stay brushed, stretches of time do not. */
export function showDataset(number: number): void {
  batch(() => {
    datasetNumber.value = number;
    stretch.value = range.value = cursor.value = hover.value = null;
    if (isStretch(brush.value)) brush.value = null;
    if (isStretch(only.value)) only.value = null;
    earlier.length = 0;
  });
}

const earlier: (Stretch | null)[] = [];
onRenewal(() => {
  earlier.length = 0;
});
let turned = 0; // when the wheel was turned last

export function zoom(to: Stretch | null): void {
  const own = dataset.value;
  if (own === undefined) return;
  earlier.push(stretch.value);
  stretch.value = to === null ? null : within(own, to);
}

export function back(): void {
  if (earlier.length) stretch.value = earlier.pop()!;
}

/** The part of a stretch within the dataset; the whole if there is none. */
function within(own: Stretch, { begin, end }: Stretch): Stretch | null {
  const [from, to] = [Math.max(own.begin, begin), Math.min(own.end, end)];
  return to > from ? { begin: from, end: to } : null;
}

/** Fit the time axis to what is brushed or measured. */
export function fit(): void {
  const own = isStretch(brush.value) ? brush.value : range.value;
  if (own === null) return;
  const pause = (own.end - own.begin) * 0.04;
  zoom({ begin: own.begin - pause, end: own.end + pause });
}

/** Move the stretch without a step of the history. */
export function shift(by: number): void {
  const own = dataset.value;
  if (own === undefined || stretch.value === null) return;
  const { begin, end } = stretch.value;
  const from = Math.max(own.begin, Math.min(own.end - (end - begin), begin + by));
  stretch.value = { begin: from, end: from + end - begin };
}

/** Zoom about a position; a factor below 1 shows less. One turn of the wheel is one step of the history. */
export function zoomAt(position: number, factor: number): void {
  const own = dataset.value;
  if (own === undefined) return;
  const { begin, end } = visible.value;
  const now = performance.now();
  if (now - turned > 600) earlier.push(stretch.value);
  turned = now;
  const wide = (end - begin) * factor;
  if (wide >= own.end - own.begin) {
    stretch.value = null;
    return;
  }
  const share = (position - begin) / (end - begin);
  const from = Math.max(own.begin, Math.min(own.end - wide, position - share * wide));
  stretch.value = { begin: from, end: from + wide };
}

/** Show the cursor if it is outside of the visible stretch. */
export function follow(position: number): void {
  const { begin, end } = visible.value;
  const margin = (end - begin) * 0.05;
  if (position < begin) shift(position - begin - margin);
  else if (position > end) shift(position - end + margin);
}

/** Light up nothing, measure nothing, and forget the cursor. */
export function clearMarks(): void {
  batch(() => {
    brush.value = range.value = cursor.value = null;
  });
}
