// What the data say about each value of the open table: samples, mean error, and where samples look it up.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "../connection";
import { css, diverging, isDark, type Rgb } from "../drawing/colours";
import { fixed, significant } from "../drawing/numbers";
import { criterion, criterionNumber } from "../plots";
import type { EditedTable } from "../replies";
import { scoped } from "../scope";
import { request, revision, screen, table, theme } from "../store";

export const overlay = signal<"" | "samples" | "error">(""); // colours cells and surface
export const pointsShown = signal(false); // dots on surface and slices

interface Coverage {
  name: string;
  error: Float32Array;
  x: Float32Array;
  y: Float32Array;
}
const coverage = scoped<Coverage | null>(null);

const load = newest(async (given: { name: string; criterion: number }) => {
  const reply = await request("coverage", given);
  const { error, x, y } = reply?.arrays ?? {};
  coverage.value = error && x ? { name: given.name, error, x, y: y ?? new Float32Array() } : null;
});

const asked = computed(() =>
  table.value !== null && table.value.axes.length > 0 && (overlay.value === "error" || pointsShown.value)
    ? table.value.name
    : "",
);

effect(() => {
  void revision.value;
  if (screen.value === "parameters" && asked.value !== "")
    load({ name: asked.value, criterion: criterionNumber.value });
});

/** How each value is coloured, null for one without data, and a short note for its cell. */
export interface Cover {
  tints: (Rgb | null)[];
  notes: string[];
}

const cover = computed<Cover | null>(() => {
  const own = table.value;
  void theme.value;
  if (own === null || overlay.value === "") return null;
  if (overlay.value === "samples") return own.samples && coverBySamples(own.samples);
  return coverage.value?.name === own.name ? coverByError(coverage.value.error) : null;
});

export const coverOf = (own: EditedTable): Cover | null => (own.name === table.value?.name ? cover.value : null);

/** Return the colours of cells; null where there is none. */
export const cellTints = (own: Cover): (string | null)[] => own.tints.map((each) => each && css(each));

const PAPER = (): Rgb => (isDark() ? [23, 26, 31] : [255, 255, 255]);
const BLUE: Rgb = [70, 130, 200];

function coverBySamples(samples: number[]): Cover {
  const most = Math.log10(1 + Math.max(1, ...samples));
  const paper = PAPER();
  const tint = (count: number) =>
    BLUE.map((part, k) =>
      Math.round(paper[k]! + (part - paper[k]!) * (Math.log10(1 + count) / most)),
    ) as unknown as Rgb;
  return {
    tints: samples.map((count) => (count ? tint(count) : null)),
    notes: samples.map((count) => (count ? short(count) : "")),
  };
}

/** A count in at most four characters: 950, 9.5k, 26k, 1.2M. */
function short(count: number): string {
  if (count < 1000) return String(count);
  const [value, letter] = count < 1e6 ? [count / 1e3, "k"] : [count / 1e6, "M"];
  return value < 9.95 ? `${value.toFixed(1)}${letter}` : `${Math.round(value)}${letter}`;
}

function coverByError(errors: Float32Array): Cover {
  const known = [...errors].filter(Number.isFinite).map(Math.abs);
  const reach = Math.max(...known, 1e-12);
  const all = [...errors];
  const decimals = Math.max(0, Math.min(6, -Math.floor(Math.log10(reach)) + (reach < 100 ? 1 : 0)));
  const note = (value: number) => (value > 0 ? "+" : "") + fixed(value, decimals);
  return {
    tints: all.map((value) => (Number.isFinite(value) ? diverging(value / reach) : null)),
    notes: all.map((value) => (Number.isFinite(value) ? note(value) : "")),
  };
}

/** What the tooltip of a value says about the data. */
export function coverTitle(own: EditedTable, cell: number): string {
  const error = coverage.value?.name === own.name && overlay.value === "error" ? coverage.value.error[cell] : undefined;
  return error === undefined || !Number.isFinite(error)
    ? ""
    : `mean error ${significant(error, 3)} ${criterion.value?.unit ?? ""}, model minus measurement`;
}

/** Where samples look the table up, with the height of the table there; null if they are not shown. */
export interface Places {
  x: ArrayLike<number>;
  y: ArrayLike<number>;
  value: Float64Array;
}

const places = computed<Places | null>(() => {
  const [data, own] = [coverage.value, table.value];
  if (!pointsShown.value || own === null || data?.name !== own.name) return null;
  const value = new Float64Array(data.x.length);
  for (let k = 0; k < value.length; k++) value[k] = heightAt(own, data.x[k]!, data.y[k] ?? 0);
  return { x: data.x, y: data.y, value };
});

export const placesOf = (own: EditedTable): Places | null => (own.name === table.value?.name ? places.value : null);

/** The value of a curve or map between its points. */
function heightAt(own: EditedTable, x: number, y: number): number {
  const [i, s] = located(own.axes[0]!.points, x);
  const ys = own.axes[1]?.points ?? [0];
  const [j, t] = located(ys, y);
  const at = (a: number, b: number) =>
    own.values[Math.min(a, own.axes[0]!.points.length - 1) * ys.length + Math.min(b, ys.length - 1)]!;
  return (1 - s) * ((1 - t) * at(i, j) + t * at(i, j + 1)) + s * ((1 - t) * at(i + 1, j) + t * at(i + 1, j + 1));
}

function located(points: number[], value: number): [number, number] {
  let cell = 0;
  while (cell + 2 < points.length && points[cell + 1]! <= value) cell++;
  const [low, high] = [points[cell]!, points[cell + 1] ?? points[cell]!];
  return [cell, high > low ? Math.max(0, Math.min(1, (value - low) / (high - low))) : 0];
}
