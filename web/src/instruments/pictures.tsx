// Two tables side by side, and their difference.

import { extent, type Pen } from "../drawing/canvas";
import { drawGrid } from "../drawing/grid";
import { MISSING, signed, significant } from "../drawing/numbers";
import { drawCurves } from "../drawing/slices";
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
  range,
  framed = [],
  hatched,
  difference = false,
}: ColumnProps) {
  const [low, high] = extent(values);
  const draw = (pen: Pen, width: number, height: number) => {
    if (axes.length === 2)
      drawGrid(
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
    else if (axes.length === 1)
      drawCurves(pen, width, height, axes[0]!.points, difference ? values.map(() => 0) : (before ?? values), values);
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

const ends = (axis: AxisPoints): [number, number] => [axis.points[0]!, axis.points[axis.points.length - 1]!];

function rowsOf(axes: AxisPoints[], values: number[]): number[][] {
  const ny = axes[1]!.points.length;
  return axes[0]!.points.map((_, i) => values.slice(i * ny, (i + 1) * ny));
}
