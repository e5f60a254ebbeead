import { expect, test } from "vitest";
import { fileName, plainText } from "../src/plain-text";

test("numbers are copied as spreadsheets read them", () => {
  expect(plainText("−12.50")).toBe("-12.50");
  expect(plainText("26\u2009482")).toBe("26482");
  expect(plainText("1.2e-5")).toBe("1.2e-5");
  expect(plainText("–")).toBe("");
});

test("texts stay texts, in one line and without tabs", () => {
  expect(plainText("a − b")).toBe("a − b");
  expect(plainText(" start\n  run 1 ")).toBe("start run 1");
  expect(plainText("a\tb")).toBe("a b");
});

test("files are named after the project and what they show", () => {
  expect(fileName("torque", "Strips of bench/1", "svg")).toBe("torque-Strips-of-bench-1.svg");
  expect(fileName("../..", "a", "png")).toBe("a.png");
  expect(fileName("", "", "tsv")).toBe("kennfeld.tsv");
});
