// What a pin would do to the uncertainty of every table, before it is applied.

import { computed, effect } from "@preact/signals";
import { tried, trust } from "../../comparison";
import { newest } from "../../connection";
import { numberText } from "../../drawing/numbers";
import type { PinnedRow, RemedyRow } from "../../replies";
import { scoped } from "../../scope";
import { request, screen } from "../../store";

const rows = scoped<PinnedRow[]>([]);

const pins = computed(() =>
  [...trust.value.remedies, ...trust.value.directions.flatMap((each) => each.remedies)].filter(
    (each) => each.kind === "pin" && !each.applied,
  ),
);
const shown = computed<RemedyRow | undefined>(
  () => pins.value.find((each) => each.title === tried.value) ?? pins.value[0],
);

const load = newest(async (own: RemedyRow) => {
  const [path, list] = own.changes.at(-1)!;
  const pin = (list as { at: number[] }[]).at(-1)!;
  const reply = await request("pinned", { parameter: String(path[1]), at: pin.at });
  rows.value = reply === null ? [] : reply.head.rows;
});

effect(() => {
  if (screen.value === "results" && shown.value !== undefined) load(shown.value);
  else rows.value = [];
});

export function IfPinned() {
  if (rows.value.length === 0 || shown.value === undefined) return null;
  return (
    <div id="if-pinned">
      <div class="head">
        <h2>If pinned</h2>
        <span class="sub" title={shown.value.title}>
          {shown.value.title.replace(/^Pin /, "")}
        </span>
      </div>
      <div class="pad">
        <p class="q">Standard deviation, median over the table</p>
        <table class="pinned">
          {rows.value.map((row) => (
            <tr>
              <td class="cut">{row.name}</td>
              <td class="num">{numberText(row.before, 3)} →</td>
              <td class="num">
                <b>{numberText(row.after, 3)}</b> <span class="q">{row.unit}</span>
              </td>
            </tr>
          ))}
        </table>
      </div>
    </div>
  );
}
