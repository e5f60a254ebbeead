import { expect, test } from "vitest";
import { cellIn } from "../src/drawing/grid";
import { nearestPixel, nearestTo } from "../src/hover-tip";

test("the nearest entry skips gaps; nothing is near where nothing is drawn", () => {
  expect(nearestTo([1, 2, 4], 3.1)).toBe(2);
  expect(nearestTo([NaN, 5, NaN], -100)).toBe(1);
  expect(nearestTo([], 0)).toBe(-1);
  expect(nearestPixel([0, 10], [0, 10], [9, 9], 8)).toBe(1);
  expect(nearestPixel([0, NaN], [0, 0], [5, 50], 8)).toBe(-1);
});

test("a cell is that of the pixel, x to the right and y upwards", () => {
  const box = { left: 40, right: 140, top: 6, bottom: 66 };
  expect(cellIn(box, 10, 3, 41, 65)).toEqual([0, 0]);
  expect(cellIn(box, 10, 3, 139, 7)).toEqual([9, 2]);
  expect(cellIn(box, 10, 3, 140, 30)).toBe(null);
  expect(cellIn(box, 10, 3, 39, 30)).toBe(null);
  expect(cellIn(box, 1, 1, 90, 30)).toEqual([0, 0]);
});
