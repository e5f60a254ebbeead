import { describe, expect, it } from "vitest";
import { secondsPerPixel, shiftOfDrag, slotOf } from "../src/shift-drag";

const FILES = [
  { timed: true, begin: 10, end: 106 },
  { timed: true, begin: 0, end: 960 },
];

describe("a drag along the lines of a channel", () => {
  it("takes the scale of the file at which it begins", () => {
    expect(slotOf(1, 2, 200)).toEqual([102, 198]);
    expect(secondsPerPixel(0, FILES, 200)).toBeCloseTo(1);
    expect(shiftOfDrag(50, 60, 200, FILES, 0.1)).toBeCloseTo(10);
    expect(shiftOfDrag(150, 160, 200, FILES, 0.1)).toBeCloseTo(100);
  });

  it("shifts to the left as well, and by whole samples", () => {
    expect(shiftOfDrag(50, 46.8, 200, FILES, 2)).toBe(-4);
    expect(shiftOfDrag(50, 50.4, 200, FILES, 2)).toBe(0);
  });

  it("shifts nothing without time stamps, without samples, or without files", () => {
    expect(shiftOfDrag(50, 60, 200, [{ timed: false, begin: 0, end: 99 }], 1)).toBe(0);
    expect(shiftOfDrag(50, 60, 200, [{ timed: true, begin: 5, end: 5 }], 1)).toBe(0);
    expect(shiftOfDrag(50, 60, 200, FILES, 0)).toBe(0);
    expect(shiftOfDrag(50, 60, 200, [], 1)).toBe(0);
  });

  it("stays finite in a picture that is not drawn yet", () => {
    expect(shiftOfDrag(0, 10, 0, FILES, 0.1)).toBe(0);
  });
});
