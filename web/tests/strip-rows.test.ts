import { beforeEach, expect, test, vi } from "vitest";
import type { AppState, DatasetRow } from "../src/replies";

vi.mock("../src/connection", () => ({
  ask: vi.fn(async () => ({ head: {}, arrays: {} })),
  newest: (send: unknown) => send,
  setReady: () => {},
}));

const { takeState } = await import("../src/store");
const strips = await import("../src/strip-rows");

const dataset: DatasetRow = {
  ...{ number: 1, name: "drive", use: "training", samples: 3, timed: true, begin: 0, end: 2, pieces: [] },
  channels: [
    { name: "n", unit: "rpm" },
    { name: "rl", unit: "%" },
  ],
};
const project: AppState = {
  ...{
    project: { id: "p", name: "p", path: "/p/kennfeld.toml" },
    revision: 1,
    textRevision: 1,
    unsaved: [],
    undo: "",
    redo: "",
  },
  ...{
    findings: [],
    code: [],
    waiting: [],
    runs: [],
    seconds: 0,
    changedOnDisk: [],
    recoverable: false,
    interrupted: false,
    function: { file: "a.kf", screen: "formula" },
  },
  job: { state: "idle", message: "", seconds: 0, run: 0, iterations: 0, validates: false },
  training: { state: "idle", file: "", seconds: 0, lines: [] },
  terms: { state: "idle", text: "", done: 0, parts: 0, seconds: 0, detail: "" },
  design: { state: "idle", text: "", done: 0, parts: 0, seconds: 0, detail: "" },
  nodes: [
    { name: "trq", unit: "Nm" },
    { name: "eta", unit: "" },
  ],
  criteria: [{ node: "trq", target: "torque", unit: "Nm" }],
  inputs: ["n", "rl", "hidden"],
  datasets: [dataset],
};

const titles = () => strips.rows.value.map((row) => row.title);
const weights = () => strips.rows.value.map((row) => row.weight);

beforeEach(() => {
  takeState({ state: { ...project, revision: project.revision + 1 } });
  strips.resetStrips();
  strips.active.value = 0;
});

test("without a choice, strips show the criterion, its error, and the inputs that are recorded", () => {
  expect(titles()).toEqual(["trq", "Error", "n", "rl"]);
  const [first] = strips.rows.value;
  expect(first!.lines.map((line) => line.label)).toEqual(["measured", "now", "start"]);
  expect(first!.unit).toBe("Nm");
  expect(strips.rows.value[2]!.unit).toBe("rpm");
});

test("with several criteria, errors are named by their nodes", () => {
  const criteria = [...project.criteria!, { node: "eta", target: "x", unit: "" }];
  takeState({ state: { ...project, revision: 5, criteria } });
  expect(titles()).toEqual(["trq", "Error of trq", "eta", "Error of eta", "n", "rl"]);
});

test("a share of the height belongs to a strip by the weights", () => {
  expect(weights()).toEqual([1.6, 1, 1, 1]);
  expect([0, 0.34, 0.36, 0.99, 2].map(strips.rowAt)).toEqual([0, 0, 1, 3, 3]);
});

test("a strip is added below the active one, which it becomes", () => {
  strips.active.value = 1;
  strips.addStrip({ kind: "node", name: "eta" });
  expect(titles()).toEqual(["trq", "Error", "eta", "n", "rl"]);
  expect(strips.active.value).toBe(2);
});

test("a line is added once, in a colour of its own", () => {
  strips.addLine(2, { kind: "channel", name: "rl" });
  strips.addLine(2, { kind: "channel", name: "rl" });
  const { lines } = strips.rows.value[2]!;
  expect(lines.map((line) => line.label)).toEqual(["measured", "rl"]);
  expect(new Set(lines.map((line) => line.colour)).size).toBe(2);
});

test("a strip without lines goes", () => {
  strips.removeLine(3, { kind: "channel", name: "rl" });
  expect(titles()).toEqual(["trq", "Error", "n"]);
  strips.removeLine(0, { kind: "start", name: "trq" });
  expect(strips.rows.value[0]!.lines).toHaveLength(2);
});

test("a strip that moves keeps the others in order", () => {
  strips.moveStrip(3, 0);
  expect(titles()).toEqual(["rl", "trq", "Error", "n"]);
  strips.moveStrip(0, 9);
  expect(titles()).toEqual(["rl", "trq", "Error", "n"]);
});

test("resizing takes from the strip below, and leaves each at least 0.4", () => {
  strips.resizeStrip(1, 0.3);
  expect(weights()).toEqual([1.6, 1.3, 0.7, 1]);
  strips.resizeStrip(1, 5);
  expect(weights()[2]).toBeCloseTo(0.4, 12);
  expect(weights().reduce((sum, each) => sum + each, 0)).toBeCloseTo(4.6, 12);
  strips.resizeStrip(1, -9);
  expect(weights()[1]).toBeCloseTo(0.4, 12);
});

test("signals in words, with their units", () => {
  expect(strips.titleOf({ kind: "target", name: "0" })).toBe("trq, measured [Nm]");
  expect(strips.nameOf({ kind: "start", name: "eta" })).toBe("eta at the start");
  expect(strips.unitOf({ kind: "channel", name: "other", unit: "bar" })).toBe("bar");
});

test("the choice is kept by project, and a damaged one is forgotten", () => {
  strips.addStrip({ kind: "node", name: "eta" });
  const key = "kennfeld.plots:/p/kennfeld.toml";
  expect(JSON.parse(localStorage.getItem(key)!).strips).toHaveLength(5);
  const other = { id: "q", name: "q", path: "/q/kennfeld.toml" };
  localStorage.setItem(
    `kennfeld.plots:${other.path}`,
    '{"strips": [{"lines": [{"kind": "nonsense", "name": "x"}]}, {"lines": [{"kind": "node", "name": "eta"}]}]}',
  );
  takeState({ state: { ...project, project: other } });
  expect(titles()).toEqual(["eta"]);
  localStorage.setItem("kennfeld.plots:/r", "{");
  takeState({ state: { ...project, project: { id: "r", name: "r", path: "/r" } } });
  expect(titles()).toEqual(["trq", "Error", "n", "rl"]);
});
