import { expect, test } from "vitest";
import { valueUnder } from "../src/hover-values";
import type { SignalName } from "../src/replies";

const criteria = [{ node: "trq", target: "torque", unit: "Nm" }];
const target: SignalName = { kind: "target", name: "0" };
const node: SignalName = { kind: "node", name: "trq" };
const error: SignalName = { kind: "error", name: "0" };

// one pixel: least and greatest of many samples, which are those of different samples in each line
const pixel = {
  begin: 0,
  raw: false,
  x: Float32Array.of(10, 10),
  lines: new Map([
    ["target:0", Float32Array.of(600, 625)],
    ["node:trq", Float32Array.of(600, 607.5)],
    ["error:0", Float32Array.of(-20, 12)],
  ]),
};

test("an error under the mouse is the calculated value there less the measured one", () => {
  const shown = [node, target, error].map((own) => valueUnder(pixel, own, 10.4, criteria));
  expect(shown).toEqual([603.75, 612.5, -8.75]);
});

test("an error whose lines are not drawn is that of the pixel, and none where nothing is scored", () => {
  const alone = { ...pixel, lines: new Map([["error:0", Float32Array.of(-20, 12)]]) };
  expect(valueUnder(alone, error, 10, criteria)).toBe(-4);
  const gap = { ...pixel, lines: new Map([...pixel.lines, ["error:0", Float32Array.of(NaN, NaN)]]) };
  expect(valueUnder(gap, error, 10, criteria)).toBeNaN();
  expect(valueUnder(null, error, 10, criteria)).toBeNaN();
});

test("each sample is drawn: the value is that of the sample before the mouse", () => {
  const raw = { ...pixel, raw: true, x: Float32Array.of(10, 11) };
  expect(valueUnder(raw, target, 10.9, criteria)).toBe(600);
  expect(valueUnder(raw, target, 11, criteria)).toBe(625);
});
