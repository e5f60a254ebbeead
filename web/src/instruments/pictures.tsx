// Two tables side by side, and their difference.

import { extent, type Pen } from "../drawing/canvas";
import { drawGrid } from "../drawing/grid";
import { MISSING, plain, signed, significant, unitText } from "../drawing/numbers";
import { drawCurves } from "../drawing/slices";
import { nearestTo, type Read } from "../hover-tip";
import type { AxisPoints } from "../replies";
import { Picture } from "./picture";

interface PicturesProps {
  axes: AxisPoints[];
  first: number[];
  second: number[];
  unit: string;
  titles: [string, string];
  bound?: number[]; // values of the second table at a bound
  hatched?: Set<number> | undefined; // values that keep those of the first
}

export function Pictures({ axes, first, second, unit, titles, bound = [], hatched }: PicturesProps) {
  const range = extent(first, second);
  return (
    <div class="tri">
      <Column title={titles[0]} axes={axes} unit={unit} values={first} range={range} hatched={hatched} />
      <Column
        title={titles[1]}
        axes={axes}
        unit={unit}
        values={second}
        before={first}
        other={titles[0]}
        range={range}
        framed={bound}
        hatched={hatched}
      />
      <Column
        title="change"
        axes={axes}
        unit={unit}
        values={second.map((value, k) => value - first[k]!)}
        hatched={hatched}
        difference
      />
    </div>
  );
}

interface ColumnProps {
  title: string;
  axes: AxisPoints[];
  unit: string;
  values: number[];
  before?: number[];
  other?: string; // what those are
  range?: readonly [number, number];
  framed?: number[];
  hatched?: Set<number> | undefined;
  difference?: boolean;
}

export function Column({
  title,
  axes,
  unit,
  values,
  before,
  other = "before",
  range,
  framed = [],
  hatched,
  difference = false,
}: ColumnProps) {
  const [low, high] = extent(values);
  const text = (k: number): string[] => [
    `${difference ? signed(values[k]!) : significant(values[k]!)} ${unitText(unit)}`,
    ...(before ? [`${other} ${significant(before[k]!)}`] : []),
  ];
  const draw = (pen: Pen, width: number, height: number): Read | undefined => {
    if (axes.length === 2) {
      const at = drawGrid(
        pen,
        width,
        height,
        {
          x: ends(axes[0]!),
          y: ends(axes[1]!),
          values: rowsOf(axes, values),
          range: range ?? extent(values),
          difference,
        },
        (i, j) => {
          const cell = i * axes[1]!.points.length + j;
          return hatched?.has(cell) ? "hatch" : framed.includes(cell) ? "frame" : "";
        },
      );
      return (x, y) => {
        const cell = at(x, y);
        if (cell === null) return null;
        return [...text(cell[0] * axes[1]!.points.length + cell[1]), placeText(axes, cell)];
      };
    }
    if (axes.length !== 1) return undefined;
    const grey = difference ? values.map(() => 0) : (before ?? values);
    const plot = drawCurves(pen, width, height, axes[0]!.points, grey, values);
    return (x) => {
      const k = nearestTo(axes[0]!.points, plot.xAt(x));
      return k < 0 ? null : [...text(k), placeText(axes, [k])];
    };
  };
  return (
    <div class="tc">
      <div class="tt">
        <b class="cut">{title}</b>
        <span class="q">
          {values.length === 0
            ? MISSING
            : low === high
              ? significant(low)
              : `${significant(low, 3)} … ${difference ? signed(high) : significant(high, 4)}`}{" "}
          {axes.length === 0 ? unit : ""}
        </span>
      </div>
      {axes.length > 0 && axes.length < 3 && <Picture label={title} draw={draw} of={[values, before, hatched]} />}
    </div>
  );
}

/** A grid point in words: `Speed 3000 rpm, Load 40 %`. */
export const placeText = (axes: readonly AxisPoints[], at: readonly number[]): string =>
  axes.map((axis, k) => `${axis.input} ${plain(axis.points[at[k]!]!, 5)} ${unitText(axis.unit)}`.trim()).join(", ");

const ends = (axis: AxisPoints): [number, number] => [axis.points[0]!, axis.points[axis.points.length - 1]!];

function rowsOf(axes: AxisPoints[], values: number[]): number[][] {
  const ny = axes[1]!.points.length;
  return axes[0]!.points.map((_, i) => values.slice(i * ny, (i + 1) * ny));
}
