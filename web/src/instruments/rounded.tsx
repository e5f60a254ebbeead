// Values that an image cannot store exactly: what was asked for, and what the raw value stands for.

import { significant } from "../drawing/numbers";
import type { RoundedRow } from "../replies";

export function RoundedTable({ rows }: { rows: RoundedRow[] }) {
  if (rows.length === 0) return null;
  return (
    <>
      <div class="head mid">
        <h2>Rounded to the raw scale</h2>
        <span class="sub">
          {rows.length} label{rows.length > 1 ? "s" : ""}
        </span>
      </div>
      <table class="list rounded">
        <thead>
          <tr>
            <th>label</th>
            <th class="num" title="Values that are not stored exactly">
              rounded
            </th>
            <th class="num" title="Largest difference between the value and what the image stores">
              at most
            </th>
            <th class="num">value</th>
            <th class="num">stored</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((row) => (
            <tr title={row.place}>
              <td>
                <b>{row.name}</b>
              </td>
              <td class="num">
                {row.differ} of {row.total}
              </td>
              <td class="num ink">{row.largest === null ? "" : significant(row.largest, 3)}</td>
              <td class="num q">{significant(Number(row.asked), 6)}</td>
              <td class="num">{significant(Number(row.stored), 6)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </>
  );
}
