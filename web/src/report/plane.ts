// The plane of a table that a report shows, and the words on its values.

import { plain } from "../drawing/numbers";
import type { TipLine } from "./elements";
import { type AxisData, equal, type ParameterFigure } from "./figures";

/**
 * The plane of a table that is shown: its first two axes, at chosen points of further ones. Of a value block, columns
 * run across, as its rows are written.
 */
export class Plane {
  readonly x: AxisData;
  readonly y: AxisData | null;
  readonly further: AxisData[];
  readonly chosen: number[]; // point of each further axis
  readonly changed: boolean;
  readonly block: boolean;

  constructor(readonly f: ParameterFigure) {
    this.block = f.type === "block" && f.axes.length > 1;
    this.x = f.axes[this.block ? 1 : 0]!;
    this.y = f.axes[this.block ? 0 : 1] ?? null;
    this.further = f.axes.slice(2);
    this.chosen = this.further.map((axis) => Math.floor(axis.points.length / 2));
    this.changed = !equal(f.before, f.after);
  }

  get nx(): number {
    return this.x.points.length;
  }

  get ny(): number {
    return this.y?.points.length ?? 1;
  }

  /** The number of a value in C order. */
  cell(i: number, j: number): number {
    return this.places(i, j).reduce((sum, k, axis) => sum * this.f.axes[axis]!.points.length + k, 0);
  }

  private places(i: number, j: number): number[] {
    return this.y === null ? [i] : [...(this.block ? [j, i] : [i, j]), ...this.chosen];
  }

  /** The values of the plane, in C order. */
  pick<T>(values: readonly T[]): T[] {
    const cells = Array.from({ length: this.nx * this.ny }, (_, k) => this.cell(Math.floor(k / this.ny), k % this.ny));
    return cells.map((cell) => values[cell]!);
  }

  /** What is to be said about a value. */
  describe(i: number, j: number): TipLine[] {
    const { f } = this;
    const at = this.cell(i, j);
    const [before, after] = [f.before[at] ?? NaN, f.after[at] ?? NaN];
    const places = this.places(i, j);
    const lines: (TipLine | false | null | undefined | 0)[] = [
      ...f.axes.map<TipLine>((axis, k) => [`${axis.title} ${plain(axis.points[places[k]!]!, 6)} ${axis.unit}`]),
      [`${this.changed ? "after" : "value"} ${plain(after, 6)} ${f.unit}`, "model"],
      this.changed && [`before ${plain(before, 6)}, change ${plain(after - before, 4)}`],
      f.deviation && [describeDeviation(f.deviation[at]!)],
      f.samples && [f.samples[at] ? `${f.samples[at]} training samples` : "no training data"],
      f.bySmoothness?.[at] && ["determined by smoothness alone"],
      f.informed?.[at] === 0 && ["undetermined: start kept"],
      f.locked[at] && ["locked"],
      f.bound[at] && [f.bound[at]! > 0 ? "at the upper bound" : "at the lower bound"],
    ];
    return lines.filter((line): line is TipLine => Boolean(line));
  }
}

function describeDeviation(value: number | null): string {
  if (value === null) return "standard deviation: not known";
  if (value === -1) return "standard deviation: not determined";
  return value === 0 ? "standard deviation 0: fixed by a limit" : `standard deviation ${plain(value, 3)}`;
}
