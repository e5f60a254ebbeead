// What a calibration file holds: a row for each label, as `kennfeld info` lists them.

import { opened, search } from "../../calibrations";
import { MISSING, significant, unitText } from "../../drawing/numbers";
import { Icon } from "../../icons";

export function ContentTable() {
  const own = opened.value;
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const rows = (own?.rows ?? []).filter((row) =>
    words.every((word) => `${row.name} ${row.description} ${row.function}`.toLowerCase().includes(word)),
  );
  return (
    <section class="pane df whole">
      <div class="head">
        <h2>{own?.label ?? MISSING}</h2>
        <span class="sub">{own ? `${own.count} names` : ""}</span>
        <span class="right">
          <label class="field small" style={{ width: "180px" }}>
            <Icon name="find" kind="q" />
            <input
              placeholder="Name, description"
              aria-label="Search contents"
              value={search.value}
              onInput={(event) => {
                search.value = event.currentTarget.value;
              }}
            />
          </label>
        </span>
      </div>
      <div class="items">
        <table class="list pt" id="contents">
          <thead>
            <tr>
              <th>name</th>
              <th>kind</th>
              <th class="num">size</th>
              <th>unit</th>
              <th class="num">least</th>
              <th class="num">greatest</th>
              <th>description</th>
            </tr>
          </thead>
          <tbody>
            {rows.map((row) => (
              <tr data-name={row.name}>
                <td>
                  <b>{row.name}</b>
                </td>
                <td class="q">{row.kind}</td>
                <td class="num">{row.size}</td>
                <td class="q">{unitText(row.unit)}</td>
                <td class="num">{row.text ? "" : row.least === null ? MISSING : significant(row.least)}</td>
                <td class="num">{row.greatest === null ? "" : significant(row.greatest)}</td>
                <td class="q cut">{row.text || row.description}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      {(own?.findings ?? []).map((text) => (
        <p class="note warn">{text}</p>
      ))}
    </section>
  );
}
