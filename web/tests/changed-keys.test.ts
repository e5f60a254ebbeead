import { expect, test } from "vitest";
import { type Change, changed } from "../src/changed-keys";

test.each<[Change, object]>([
  [[["fit", "step"], 2], { fit: { step: 2 }, dataset: [{ files: "a" }] }],
  [[["fit"], null], { dataset: [{ files: "a" }] }],
  [[["axes", "Speed", "begin"], 700], { fit: { step: 1 }, dataset: [{ files: "a" }], axes: { Speed: { begin: 700 } } }],
  [[["axes", "Speed", "begin"], null], { fit: { step: 1 }, dataset: [{ files: "a" }] }],
  [[["dataset", 1, "weight"], 3], { fit: { step: 1 }, dataset: [{ files: "a", weight: 3 }] }],
  [[["dataset", 2], { files: "b" }], { fit: { step: 1 }, dataset: [{ files: "a" }, { files: "b" }] }],
  [[["dataset", 2, "files"], "b"], { fit: { step: 1 }, dataset: [{ files: "a" }, { files: "b" }] }],
  [[["dataset", 1], null], { fit: { step: 1 }, dataset: [] }],
  [[["dataset", 2], null], { fit: { step: 1 }, dataset: [{ files: "a" }] }],
  [[["dataset", 7], { files: "b" }], { fit: { step: 1 }, dataset: [{ files: "a" }] }],
])("a change %j is shown before it is answered", (change, expected) => {
  const settings = { fit: { step: 1 }, dataset: [{ files: "a" }] };
  expect(changed(settings, [change])).toEqual(expected);
  expect(settings).toEqual({ fit: { step: 1 }, dataset: [{ files: "a" }] });
});

test("changes that follow each other build on each other", () => {
  const lines: Change[] = [
    [["criterion", 1], { node: "y" }],
    [["criterion", 1, "weight"], 2],
    [["criterion", 2], { node: "z" }],
  ];
  expect(changed({}, lines)).toEqual({ criterion: [{ node: "y", weight: 2 }, { node: "z" }] });
});
