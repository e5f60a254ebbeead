import { expect, test } from "vitest";
import { changeOf, linesOf, othersText, shortened, shownLines } from "../src/header-lines";
import type { ScoreRow } from "../src/replies";

const score = (criterion: string, use: string, rmse: number, own: Partial<ScoreRow> = {}): ScoreRow => ({
  ...{ criterion, use, unit: "Nm", samples: 10, rmse, before: 10, last: rmse, mean: 0, largest: 1 },
  ...own,
});
const scores = [
  score("trq", "training", 2),
  score("trq", "test", 3),
  score("drag", "training", 9),
  score("drag", "test", 0, { samples: 0, rmse: null }),
  score("temp", "training", 1, { last: 0.5 }),
];

test("a criterion without samples of a use has no score of it", () => {
  expect(
    linesOf(scores).map(({ criterion, training, test: other }) => [criterion, training?.rmse, other?.rmse]),
  ).toEqual([
    ["trq", 2, 3],
    ["drag", 9, undefined],
    ["temp", 1, undefined],
  ]);
  expect(linesOf([])).toEqual([]);
});

test("of more than two criteria the one that has improved least is shown, or the chosen one", () => {
  const lines = linesOf(scores);
  const names = (chosen: string) => shownLines(lines, chosen).map((each) => each.criterion);
  expect([names(""), names("temp"), names("gone")]).toEqual([["drag"], ["temp"], ["drag"]]);
  expect(shownLines(lines.slice(0, 2), "").map((each) => each.criterion)).toEqual(["trq", "drag"]);
  expect(othersText(lines, lines[1]!)).toBe("2 more, 1 worse than before the edit");
  expect(othersText(lines, lines[2]!)).toBe("2 more, none worse than before the edit");
});

test("a long name loses its middle", () => {
  expect(shortened("TorquePredict", 14)).toBe("TorquePredict");
  expect(shortened("TemperaturePredicted", 11)).toBe("Tempe…icted");
  expect(shortened("x".repeat(200), 14)).toHaveLength(14);
});

test("does not take the rounding of a sum for a change by the edit", () => {
  expect(changeOf(1.474, 1.474 + 8.9e-16)).toBe(0);
  expect(changeOf(1.474, 1.4740001)).toBeCloseTo(1e-7);
  expect(changeOf(Infinity, 0)).not.toBeGreaterThan(0);
});
