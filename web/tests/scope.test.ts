import { readdirSync, readFileSync } from "node:fs";
import { join, relative } from "node:path";
import { effect } from "@preact/signals";
import { expect, test, vi } from "vitest";
import type { StateNews } from "../src/replies";

let answer: (reply: object) => void = () => {};

vi.mock("../src/connection", () => ({
  ask: () => new Promise((resolve) => (answer = resolve)),
  newest: (send: unknown) => send,
  setReady: () => {},
}));

const { onRenewal, projectId, renew, scoped } = await import("../src/scope");
const { failure, message, openName, request, state, takeState } = await import("../src/store");

const news = (id: string, revision = 1): StateNews =>
  ({
    state: {
      project: { id, name: id, path: `/${id}` },
      revision,
      job: { state: "idle", message: "", seconds: 0, run: 1, iterations: 0 },
      parameters: id === "a" ? [{ name: "MapA", kind: "map" }] : [],
    },
  }) as unknown as StateNews;

test("what belongs to a project takes its first value when another one is opened, and only then", () => {
  const chosen = scoped<string[]>([]);
  const kept = new Map([["x", 1]]);
  onRenewal(() => kept.clear());
  renew("first");
  chosen.value = ["MapX"];
  renew("first");
  expect([chosen.value, kept.size]).toEqual([["MapX"], 0]);
  kept.set("y", 2);
  renew("second");
  expect([chosen.value, kept.size, projectId()]).toEqual([[], 0, "second"]);
});

test("another project is shown at once: no moment has the state of one and the choices of the other", () => {
  takeState(news("a"));
  message.value = "Run 1: converged.";
  const seen: string[] = [];
  effect(() => {
    seen.push(`${state.value.project?.id} ${openName.value} ${message.value}`);
  });
  takeState(news("b"));
  expect(seen).toEqual(["a MapA Run 1: converged.", "b  "]);
});

test.each([
  ["of the project before", { project: "a", revision: 9 }],
  ["about values before the present ones", { project: "b", revision: 4 }],
])("an answer %s is dropped without a word", async (_, reply) => {
  takeState(news("a"));
  takeState(news("b", 5));
  const asked = request("worst", { dataset: 0, criterion: 0 });
  answer({ head: {}, arrays: {}, ...reply });
  expect(await asked).toBe(null);
  expect(failure.value).toBe("");
});

test("an answer that arrives after another project was opened is dropped, also if it names none", async () => {
  takeState(news("a"));
  const asked = request("worst", { dataset: 0, criterion: 0 });
  takeState(news("b", 5));
  answer({ head: {}, arrays: {}, project: "b", revision: 9 });
  expect(await asked).toBe(null);
});

// What outlasts a project: the frame of the page, lists that are not about one project, and how things are shown.
const OF_THE_PAGE = new Set([
  "store.ts state connected screen theme",
  "restart.ts foreign",
  "activity.tsx reported uploading shown stopping began now",
  "commands.ts overlay",
  "copy-menu.tsx shown",
  "hover-tip.tsx shown",
  "projects.ts known chosen filter opening leaving",
  "schema.ts sections shownForms",
  "runs.ts view",
  "plots.ts width tool part",
  "navigation.ts panel",
  "instruments/error-split.tsx mounted",
  "instruments/strip-pointer.ts pending",
  "instruments/coverage.ts overlay pointsShown",
  "screens/function/flow.tsx pageWidth",
  "screens/function/fold.tsx opened",
  "screens/function/block-tree.tsx column",
  "instruments/map-table.tsx shownMarks",
  "screens/optimization.tsx quantity",
  "screens/plots.tsx wide",
  "screens/start/new-project.tsx path name over",
]);

test("every other signal of a module belongs to the open project", () => {
  const found = new Set<string>();
  for (const file of readdirSync("src", { recursive: true, encoding: "utf8" })) {
    const path = relative("src", join("src", file));
    if (!/\.tsx?$/.test(path) || /^(report|drawing)\//.test(path) || path === "scope.ts") continue;
    const text = readFileSync(join("src", path), "utf8");
    const names = [...text.matchAll(/^(?:export )?const (\w+) = (?:signal[<(]|\{[^}]*signal\()/gm)].map(
      (each) => each[1],
    );
    if (names.length > 0 && !text.startsWith("// Screens that are loaded")) found.add([path, ...names].join(" "));
  }
  expect(found).toEqual(OF_THE_PAGE);
});
