import { describe, expect, test } from "vitest";
import { cellAt, cellsOf } from "../src/instruments/table-cells";
import { asOperation, describeCells, editCells, readEdit, readPaste, smallStep } from "../src/instruments/table-edits";
import type { EditedTable } from "../src/replies";
import type { Selection } from "../src/store";

function table(points: number[][], values: number[], own: Partial<EditedTable> = {}): EditedTable {
  const axes = points.map((each, k) => ({ input: `in${k}`, unit: "", points: each }));
  const empty = {
    unit: "",
    description: "",
    referenceTitle: "start",
    locked: [],
    pinned: [],
    waiting: [],
    lower: [],
    upper: [],
    samples: null,
    deviation: null,
  };
  return { name: "MapX", kind: "map", axes, values, reference: values.map((v) => v + 1), ...empty, ...own };
}

const chosen = (x: [number, number], y: [number, number]): Selection => ({ x, y, active: [x[0], y[0]] });

// f(x, y) = 2 x + 3 y + x y is bilinear, so that interpolation between corners restores it
const X = [0, 1, 3, 4];
const Y = [10, 20, 40];
const bilinear = X.flatMap((x) => Y.map((y) => 2 * x + 3 * y + x * y));
const map = table([X, Y], bilinear);

test("a value is found by its indices in C order", () => {
  expect(cellAt(map, 2, 1)).toBe(7);
  expect(map.values[cellAt(map, 2, 1)]).toBe(2 * 3 + 3 * 20 + 60);
  expect(cellsOf(map, chosen([1, 2], [0, 1]))).toEqual([3, 4, 6, 7]);
  expect(cellAt(table([], [5]), 0, 0)).toBe(0);
});

describe("edits of the selected values", () => {
  const all = chosen([0, 3], [0, 2]);
  const cells = cellsOf(map, all);

  test("set, add, scale and take the reference", () => {
    const three = [0, 1, 2];
    expect(editCells(map, all, three, { kind: "set", title: "", amount: 7 })).toEqual([7, 7, 7]);
    expect(editCells(map, all, three, { kind: "add", title: "", amount: 0.5 })).toEqual([30.5, 60.5, 120.5]);
    expect(editCells(map, all, three, { kind: "scale", title: "", amount: 2 })).toEqual([60, 120, 240]);
    expect(editCells(map, all, three, { kind: "reference", title: "" })).toEqual([31, 61, 121]);
  });

  test("interpolation restores a bilinear table from its corners", () => {
    const spoilt = table(
      [X, Y],
      bilinear.map((value, k) => ([0, 2, 9, 11].includes(k) ? value : 999)),
    );
    expect(editCells(spoilt, all, cells, { kind: "interpolate", title: "" })).toEqual(bilinear);
  });

  test("a row is interpolated between its ends", () => {
    const spoilt = table(
      [X, Y],
      bilinear.map((value, k) => (k === 4 || k === 7 ? 0 : value)),
    );
    const row = chosen([0, 3], [1, 1]);
    expect(editCells(spoilt, row, cellsOf(spoilt, row), { kind: "interpolate", title: "" })).toEqual([
      60, 82, 126, 148,
    ]);
  });

  test("smoothing keeps what is linear over uneven breakpoints, and halves a spike", () => {
    const linear = table(
      [X],
      X.map((x) => 5 - 2 * x),
    );
    const curve = chosen([0, 3], [0, 0]);
    expect(editCells(linear, curve, [0, 1, 2, 3], { kind: "smooth", title: "" })).toEqual(linear.values);
    const spike = table([[0, 1, 2]], [0, 8, 0]);
    expect(editCells(spike, chosen([0, 2], [0, 0]), [0, 1, 2], { kind: "smooth", title: "" })).toEqual([0, 4, 0]);
  });

  test("a step is a thousandth of the span, rounded to 1, 2 or 5", () => {
    expect(smallStep(table([[0, 1]], [0, 1000]))).toBe(1);
    expect(smallStep(table([[0, 1]], [0, 2500]))).toBe(2);
    expect(smallStep(table([[0, 1]], [0, 4]))).toBe(0.005);
    expect(smallStep(table([], [0]))).toBe(0.001);
    const [stepped] = editCells(table([[0, 1]], [0, 1000]), all, [0], { kind: "step", title: "", amount: -1 })!;
    expect(stepped).toBe(-1);
  });

  test("a step is never below the last digit that is shown", () => {
    expect(smallStep(table([[0, 1]], [100, 103.6]))).toBe(0.1); // a thousandth of the span would be 0.005
    expect(smallStep(table([[0, 1]], [1, 1.004]))).toBe(0.001);
    expect(smallStep(table([[0, 1]], [2e8, 2.0001e8]))).toBe(1e6);
    expect(smallStep(table([[0, 1]], [0, 1000]))).toBe(1);
  });

  test("a step, a sum and a factor hold whatever the values are by then; a set value does not depend on them", () => {
    const own = table([[0, 1]], [0, 1000]);
    expect(asOperation(own, { kind: "step", title: "", amount: -10 })).toEqual({ kind: "add", amount: -10 });
    expect(asOperation(own, { kind: "scale", title: "", amount: 1.1 })).toEqual({ kind: "scale", amount: 1.1 });
    expect(asOperation(own, { kind: "set", title: "", amount: 1 })).toBeNull();
    expect(asOperation(own, { kind: "smooth", title: "" })).toBeNull();
  });
});

test("cells are named by their place or their number", () => {
  expect(describeCells(map, chosen([2, 2], [1, 1]))).toBe("MapX at 3, 20");
  expect(describeCells(map, chosen([0, 2], [0, 1]))).toBe("MapX, 3 × 2 points");
  expect(describeCells(table([X], [1, 2, 3, 4]), chosen([0, 2], [0, 0]))).toBe("MapX, 3 points");
  expect(describeCells(table([], [1], { name: "K" }), chosen([0, 0], [0, 0]))).toBe("K");
});

test("what is typed is a number, or an operator and a number", () => {
  expect(readEdit("5")).toEqual({ kind: "set", title: "set to 5", amount: 5 });
  expect(readEdit("=-5")).toMatchObject({ kind: "set", amount: -5 });
  expect(readEdit("*1,1")).toMatchObject({ kind: "scale", amount: 1.1 });
  expect(readEdit("/4")).toMatchObject({ kind: "scale", amount: 0.25 });
  expect(readEdit("+3")).toMatchObject({ kind: "add", amount: 3 });
  expect(readEdit("-3")).toMatchObject({ kind: "set", amount: -3 });
  expect(readEdit("high")).toBeNull();
  expect(readEdit("")).toBeNull();
});

describe("what a spreadsheet has copied", () => {
  const two = table(
    [
      [0, 1, 2],
      [0, 1],
    ],
    [0, 1, 2, 3, 4, 5],
    { locked: [1] },
  );

  test("is set from the corner of the selection on, with commas as in German", () => {
    const pasted = readPaste(two, chosen([1, 1], [0, 0]), "1,5\t2\r\n3\t4\r\n");
    expect(pasted).toMatchObject({ cells: [2, 4, 3, 5], values: [1.5, 2, 3, 4] });
    expect(pasted.filled).toEqual({ x: [1, 2], y: [0, 1], active: [1, 0] });
    expect(pasted.remark).toBe("Pasted 4 values into MapX.");
  });

  test("keeps locked values, and says what is left out and cut", () => {
    const pasted = readPaste(two, chosen([0, 0], [0, 0]), "7\tx\t8\t9\n7\t7\t7\t7\n1\t1\t1\t1");
    expect(pasted.cells).toEqual([0, 4, 3, 5]);
    expect(pasted.remark).toBe("Pasted 4 values into MapX; left out: 1 not numbers, 1 locked, 6 beyond the table.");
    expect(readPaste(two, chosen([0, 0], [1, 1]), "5").remark).toBe("Nothing was pasted; left out: 1 locked.");
  });
});
