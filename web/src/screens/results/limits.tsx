// The limits of the project with both sets: held, or how far the worst value is beyond.

import { first, limits, nameOfSet, second } from "../../comparison";
import { MISSING, significant, unitText } from "../../drawing/numbers";
import type { LimitState } from "../../replies";

export function LimitsPane() {
  const rows = limits.value;
  if (rows.length === 0) return null;
  const [a, b] = [nameOfSet(first.value), nameOfSet(second.value)];
  return (
    <section class="pane" id="limits" aria-label="Limits">
      <div class="head">
        <h2>Limits</h2>
        <span class="sub">worst violation</span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>limit</th>
            <th class="num">{a}</th>
            <th class="num">{b}</th>
          </tr>
        </thead>
        <tbody>
          {rows.map((row) => (
            <tr>
              <td class="cut" title={`${row.name} ${row.text} ${row.unit}`}>
                <b>{row.name}</b> {row.text} <span class="q">{unitText(row.unit)}</span>
              </td>
              <td class="num">
                <State own={row.first} unit={row.unit} />
              </td>
              <td class="num">
                <State own={row.second} unit={row.unit} />
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}

function State({ own, unit }: { own: LimitState; unit: string }) {
  if (own.excess === null) return <span class="q">{MISSING}</span>;
  if (own.excess > 0)
    return (
      <span class="bad" title={`${significant(own.excess, 4)} ${unitText(unit)} beyond it ${own.worst}`}>
        {significant(own.excess, 2)} {unitText(unit)}
      </span>
    );
  return own.active > 0 ? <span>{own.active} at it</span> : <span class="good">held</span>;
}
