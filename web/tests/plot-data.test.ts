import { beforeEach, expect, test, vi } from "vitest";
import type { AppState, SignalName } from "../src/replies";

const asked: [string, Record<string, unknown>][] = [];
const answers: Record<string, (given: never) => { head: object; arrays?: Record<string, Float32Array> }> = {};

vi.mock("../src/connection", () => ({
  ask: async (question: string, given: Record<string, unknown>) => {
    asked.push([question, given]);
    return { project: "p", revision: 1e9, arrays: {}, ...answers[question]!(given as never) };
  },
  newest: (send: unknown) => send,
  setReady: () => {},
}));

const { screen, takeState } = await import("../src/store");
const plots = await import("../src/plots");
const { brushed, drawn, points, pair, rangeRows, sample, stepCursor } = await import("../src/plot-data");

const project: AppState = {
  ...{
    project: { id: "p", name: "p", path: "/p" },
    revision: 1,
    textRevision: 1,
    unsaved: [],
    undo: "",
    redo: "",
    findings: [],
  },
  ...{
    code: [],
    waiting: [],
    runs: [],
    seconds: 0,
    changedOnDisk: [],
    recoverable: false,
    interrupted: false,
    function: { file: "a.kf", screen: "formula" },
    inputs: ["n"],
  },
  job: { state: "idle", message: "", seconds: 0, run: 0, iterations: 0, validates: false },
  training: { state: "idle", file: "", seconds: 0, lines: [] },
  terms: { state: "idle", text: "", done: 0, parts: 0, seconds: 0, detail: "" },
  design: { state: "idle", text: "", done: 0, parts: 0, seconds: 0, detail: "" },
  nodes: [{ name: "trq", unit: "Nm" }],
  criteria: [{ node: "trq", target: "torque", unit: "Nm" }],
  datasets: [
    {
      ...{ number: 1, name: "a", use: "training", samples: 3, timed: true, begin: 0, end: 100, pieces: [] },
      channels: [{ name: "n", unit: "rpm" }],
    },
  ],
};
const row = (mean: number) => ({ samples: 1, least: mean, mean, greatest: mean, rms: mean });
const settled = () => new Promise((resolve) => setTimeout(resolve));

Object.assign(answers, {
  strip: ({ signals, begin }: { signals: SignalName[]; begin: number }) => {
    const lines = signals.slice(1).map((_, k) => [String(k + 1), Float32Array.of(k)]);
    const arrays = { x: Float32Array.of(0), lit: new Float32Array(), ...Object.fromEntries(lines) };
    return { head: { begin, raw: true, missing: { "0": "a has no target 0" } }, arrays };
  },
  cursor: ({ position, step, signals }: { position: number; step: number; signals: SignalName[] }) => ({
    head: { sample: 7, position: position + (step ?? 0), values: signals.map((_, k) => (k ? k : null)) },
  }),
  statistics: ({ signals }: { signals: SignalName[] }) => ({ head: { statistics: signals.map((_, k) => row(k)) } }),
  passed: () => ({ head: { samples: 12 }, arrays: { MapX: Float32Array.of(1, 2) } }),
  conditions: () => ({ head: { where: "n > 3", outside: "", region: "", reason: "", regionReason: "" } }),
  points: ({ signals }: { signals: SignalName[] }) => ({
    head: { begin: 0 },
    arrays: {
      lit: new Float32Array(1),
      position: Float32Array.of(1),
      [String(signals.length - 1)]: Float32Array.of(5),
    },
  }),
  scatter: () => ({ head: {} }),
  table: () => ({ head: { table: null } }),
  signals: () => ({ head: { signals: [] } }),
});

beforeEach(async () => {
  plots.clearMarks();
  plots.zoom(null);
  takeState({ state: project });
  screen.value = "plots";
  await settled();
  asked.length = 0;
});

test("lines that the dataset lacks are missing with their reason, the others keep their order", async () => {
  plots.zoom({ begin: 10, end: 20 });
  await settled();
  expect(drawn.value!.begin).toBe(10);
  expect([...drawn.value!.missing]).toEqual([["target:0", "a has no target 0"]]);
  expect([...drawn.value!.lines.keys()]).toEqual(["node:trq", "start:trq", "error:0", "channel:n"]);
});

test("nothing is asked while another screen is shown", async () => {
  screen.value = "data";
  asked.length = 0;
  plots.zoom({ begin: 30, end: 40 });
  await settled();
  expect(asked.filter(([question]) => question === "strip")).toEqual([]);
});

test("steps of the cursor add up, and begin in the middle", async () => {
  stepCursor(1);
  await settled();
  expect(sample.value).toMatchObject({ dataset: 0, sample: 7, position: 51 });
  expect(plots.cursor.value).toBe(51);
  expect(sample.value!.values.get("target:0")).toBeNaN();
  expect(sample.value!.values.get("node:trq")).toBe(1);
});

test("what is brushed has the statistics of the error first, then those of the lines", async () => {
  plots.brush.value = { begin: 5, end: 9 };
  await settled();
  expect(brushed.value).toMatchObject({ samples: 12, rmse: 0, mean: 0, conditions: { where: "n > 3" } });
  expect(brushed.value!.statistics.get("target:0")!.mean).toBe(1);
  expect([...brushed.value!.weights.MapX!]).toEqual([1, 2]);
  plots.brush.value = null;
  expect(brushed.value).toBeNull();
});

test("a measured range has each line at both ends, in its colour", async () => {
  plots.range.value = { begin: 1, end: 4 };
  await settled();
  const rows = rangeRows.value!;
  expect(rows.map((each) => plots.keyOf(each.signal))).toEqual([
    "target:0",
    "node:trq",
    "start:trq",
    "error:0",
    "channel:n",
  ]);
  expect(rows[0]!.begin).toBeNaN();
  expect(rows[4]).toMatchObject({ begin: 4, end: 4, label: "n", statistics: row(4) });
});

test("points of two signals; one that the dataset lacks has no values", async () => {
  pair.value = [
    { kind: "channel", name: "n" },
    { kind: "node", name: "trq" },
  ];
  await settled();
  expect(points.value!.values[0]).toBeUndefined();
  expect([...points.value!.values[1]!]).toEqual([5]);
  expect(asked.at(-1)![1]).toMatchObject({ dataset: 0, criterion: 0, most: 6000 });
  pair.value = null;
});
