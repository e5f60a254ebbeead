import { describe, expect, it } from "vitest";
import { ticks, ticksApart, tickTexts } from "../src/drawing/canvas";

const WIDTH = (text: string): number => 7 * text.length;

describe("ticks of an axis in space", () => {
  it("are as many as wanted where there is room", () => {
    expect(ticksApart(700, 6100, 5, (value) => [value, 0], WIDTH)).toEqual(ticks(700, 6100, 5));
  });

  it("are fewer along a short axis, and their numbers do not touch", () => {
    const placeOf = (value: number) => [(value - 700) / 54, (value - 700) / 200] as const;
    const values = ticksApart(700, 6100, 5, placeOf, WIDTH);
    expect(values.length).toBeGreaterThan(1);
    expect(values.length).toBeLessThan(ticks(700, 6100, 5).length);
    const wide = Math.max(...tickTexts(values).map(WIDTH));
    for (const [k, value] of values.slice(1).entries())
      expect(placeOf(value)[0] - placeOf(values[k]!)[0]).toBeGreaterThan(wide);
  });

  it("are the ends where only one round number has room", () => {
    expect(ticksApart(700, 6100, 5, (value) => [value / 100, 0], WIDTH)).toEqual([700, 6100]);
  });

  it("stay where a steep axis has room for lines one below the other", () => {
    expect(ticksApart(700, 6100, 5, (value) => [0, value / 20], WIDTH)).toEqual(ticks(700, 6100, 5));
  });

  it("are one on an axis that is seen from its end", () => {
    expect(ticksApart(0, 10, 5, () => [3, 4], WIDTH)).toEqual([0]);
  });

  it("are one on an axis of one value", () => {
    expect(ticksApart(5, 5, 5, () => [0, 0], WIDTH)).toEqual([5]);
  });
});
