import { expect, it } from "vitest";
import { tableDecimals } from "../src/drawing/numbers";

it.each([
  [[], 0],
  [[0, 0], 0],
  [[700, 1000, 6100], 0],
  [[0.5, 12], 1],
  [[0.5, 0.25, 12], 2],
  [[82.51234, 1, 2], 2],
  [[1, 2, 82.51234], 2],
  [[0.0001234, Number.NaN], 7],
  [[1e-12], 0],
  [[Number.POSITIVE_INFINITY, 1.25], 2],
])("the numbers %j of a table have %i decimals", (values, decimals) => {
  expect(tableDecimals(values)).toBe(decimals);
});
