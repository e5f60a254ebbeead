import { expect, test } from "vitest";
import { afterEdit, PendingEdits } from "../src/pending-edits";
import type { ValueEdit } from "../src/replies";

const step = (amount: number, cells = [0]): ValueEdit => ({ name: "M", cells, title: "raised", kind: "add", amount });
const set = (value: number, drag = "", cells = [0]): ValueEdit => ({
  ...{ name: "M", cells, title: "set", kind: "set" },
  ...{ values: cells.map(() => value), drag },
});

/** A server that answers each edit after `presses` further ones. */
function served(
  edits: ValueEdit[],
  start: number[],
  presses: number,
): { server: number[]; shown: number[][]; sent: number } {
  const pending = new PendingEdits();
  let [server, waited, sent] = [start, 0, 0];
  let underway: ValueEdit | null = null;
  const shown: number[][] = [];
  const answer = () => {
    server = afterEdit(server, underway!);
    pending.answered();
    underway = pending.take();
    if (underway !== null) sent++;
    waited = 0;
  };
  for (const edit of edits) {
    pending.add(edit);
    if (underway === null) {
      underway = pending.take();
      sent++;
    } else if (++waited === presses) answer();
    shown.push(pending.over("M", server)); // a table that arrives now
  }
  while (underway !== null) answer();
  expect(pending.isEmpty).toBe(true);
  return { server, shown, sent };
}

test.each([1, 3, 7, 1000])("a hundred steps arrive and are shown at once, answered after %i presses", (presses) => {
  const edits = Array.from({ length: 100 }, () => step(0.02));
  const { server, shown, sent } = served(edits, [100, 5], presses);
  expect(server).toEqual([102, 5]);
  expect(shown.map(([value]) => value)).toEqual(edits.map((_, k) => Number((100 + 0.02 * (k + 1)).toPrecision(12))));
  expect(sent).toBeLessThanOrEqual(Math.ceil(100 / presses) + 1);
});

test("of the moves of a drag that wait only the last one is sent; edits between them stay in order", () => {
  const { server, sent } = served([set(1), set(2, "d"), set(3, "d"), set(4, "d")], [0], 1000);
  expect([server, sent]).toEqual([[4], 2]);
  expect(served([step(1), set(5), step(1), step(1)], [0], 1000).server).toEqual([7]);
  expect(served([step(1), step(1, [1]), step(1)], [0, 0], 1000).server).toEqual([2, 1]);
});

test("edits of another table are not shown in this one", () => {
  const pending = new PendingEdits();
  pending.add({ ...step(1), name: "Other" });
  expect(pending.over("M", [1])).toEqual([1]);
});

test("factors are rounded as steps are", () => {
  expect(afterEdit([0.1], { name: "M", cells: [0], title: "", kind: "scale", amount: 3 })).toEqual([0.3]);
});
