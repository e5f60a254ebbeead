import { expect, it } from "vitest";
import { distinctNames } from "../src/data-names";

it("leaves out what several names begin with", () => {
  expect(distinctNames(["bench_01.csv", "bench_02.csv", "fresh.mf4"])).toEqual(["01", "02", "fresh"]);
  expect(distinctNames(["day 1 cold.csv", "day 1 warm.csv"])).toEqual(["cold", "warm"]);
  expect(distinctNames(["2026-01-02.mf4"])).toEqual(["2026-01-02"]);
});
