import "./page-stub";
import { expect, test, vi } from "vitest";
import type { EditedTable, StateNews } from "../src/replies";

interface Asked {
  question: string;
  given: Record<string, unknown>;
  answer: (head?: object) => void;
}
const asked: Asked[] = [];

vi.mock("../src/connection", () => ({
  ask: (question: string, given: Record<string, unknown> = {}) =>
    new Promise((resolve) => {
      asked.push({ question, given, answer: (head = {}) => resolve({ project: "a", revision: 1, head, arrays: {} }) });
    }),
  newest: (send: unknown) => send,
  setReady: () => {},
}));

const { move, request, setValues, table, takeState } = await import("../src/store");
const { setKeys, settings, valueAt } = await import("../src/settings");
const { run } = await import("../src/runs");
const { save } = await import("../src/saving");

const questions = () => asked.map(({ question, given }) => `${question} ${given.values ?? ""}`.trim());
const done = () => new Promise((resolve) => setTimeout(resolve));

function open(): void {
  takeState({
    state: { project: { id: "a", name: "a", path: "/a" }, revision: 1, job: { state: "idle" }, parameters: [] },
  } as unknown as StateNews);
  table.value = { name: "Map", values: [0], axes: [], locked: [] } as unknown as EditedTable;
  asked.length = 0;
}

test("a second click on Run or Save while the first one is answered asks nothing; a later one does", async () => {
  open();
  run();
  run();
  const first = save();
  const second = save();
  expect(questions()).toEqual(["run", "save"]);
  for (const each of asked) each.answer();
  expect(await Promise.all([first, second])).toEqual([true, true]);
  run();
  expect(questions()).toEqual(["run", "save", "run"]);
  asked[2]!.answer();
  await done();
});

test("two presses of Undo undo two edits", () => {
  open();
  void move("undo");
  void move("undo");
  expect(questions()).toEqual(["undo", "undo"]);
});

test.each<[string, () => unknown]>([
  ["undo", () => move("undo")],
  ["save", () => save()],
  ["run", run],
])(
  "edits that wait for an answer are sent before %s, and no other edit before they are answered",
  async (name, command) => {
    open();
    setValues([0], [5], "set to 5");
    setValues([0], [7], "set to 7");
    expect(questions()).toEqual(["set-values 5"]);
    command();
    expect(questions()).toEqual(["set-values 5", "set-values 7", name]);
    setValues([0], [9], "set to 9");
    asked[0]!.answer();
    await done();
    expect(questions()).toEqual(["set-values 5", "set-values 7", name]);
    asked[1]!.answer();
    await done();
    expect(questions()).toEqual(["set-values 5", "set-values 7", name, "set-values 9"]);
    expect(table.value!.values).toEqual([9]);
    for (const each of asked) each.answer();
    await done();
  },
);

test("what is entered into a second field builds on the first one, also before it is answered", async () => {
  open();
  settings.value = { ...settings.value, settings: { parameters: { Map: { bounds: [0, 10] } } } };
  const path = ["parameters", "Map", "bounds"];
  void setKeys([[path, [2, 10]]], "bounds");
  expect(valueAt(path)).toEqual([2, 10]);
  void setKeys([[["parameters", "Map", "smooth"], 3]], "smooth");
  expect(valueAt(["parameters", "Map"])).toEqual({ bounds: [2, 10], smooth: 3 });
  for (const each of asked) each.answer();
  await done();
  expect(valueAt(["parameters", "Map"])).toEqual({ bounds: [2, 10], smooth: 3 });
});

test("a question that is no command is asked as often as it is needed", () => {
  open();
  void request("worst", { dataset: 0, criterion: 0 });
  void request("worst", { dataset: 0, criterion: 0 });
  expect(questions()).toEqual(["worst", "worst"]);
});
