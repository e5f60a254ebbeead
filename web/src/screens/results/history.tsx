// The history: what can be compared, each with its errors. One entry is A, another one B.

import { addFiles, folder } from "../../calibrations";
import { choose, files, first, history, nameOfSet, second } from "../../comparison";
import { numberText, significant } from "../../drawing/numbers";
import type { SetRow } from "../../replies";
import { clock } from "../../spoken";
import { state } from "../../store";

export function HistoryPane() {
  return (
    <section class="pane hist" aria-label="History">
      <div class="head">
        <h2>History</h2>
        <span class="right q">pick A and B</span>
      </div>
      <div class="items">
        {history.value.map((row, k) => (
          <Entry key={row.key || `cv ${k}`} own={row} />
        ))}
        {files.value.map((name) => (
          <FileEntry key={name} name={name} />
        ))}
        {state.value.runs.length === 0 && (
          <p class="pad q">
            No run yet. <kbd>F5</kbd> starts one.
          </p>
        )}
      </div>
      <FileChoice />
    </section>
  );
}

function keys(event: KeyboardEvent, key: string): void {
  if (event.key === "a") choose("first", key);
  else if (event.key === "b" || event.key === "Enter") choose("second", key);
  else return;
  event.preventDefault();
}

function Badges({ own, name }: { own: string; name: string }) {
  return (
    <span class="badges">
      <button
        class={`ab a ${first.value === own ? "on" : ""}`}
        aria-pressed={first.value === own}
        aria-label={`Compare ${name} as A`}
        title="Make it A (a)"
        onClick={(event) => {
          event.stopPropagation();
          choose("first", own);
        }}
      >
        A
      </button>
      <button
        class={`ab b ${second.value === own ? "on" : ""}`}
        aria-pressed={second.value === own}
        aria-label={`Compare ${name} as B`}
        title="Make it B (b)"
        onClick={(event) => {
          event.stopPropagation();
          choose("second", own);
        }}
      >
        B
      </button>
    </span>
  );
}

const isChosen = (key: string): boolean => key !== "" && (first.value === key || second.value === key);

function Entry({ own }: { own: SetRow }) {
  const held = own.key === "";
  return (
    <div
      class={`he ${isChosen(own.key) ? "on" : ""}`}
      data-set={own.key || "cross-validation"}
      tabIndex={held ? undefined : 0}
      onClick={() => {
        if (!held) choose("second", own.key);
      }}
      onKeyDown={(event) => {
        if (!held) keys(event, own.key);
      }}
    >
      {held ? <span class="badges" /> : <Badges own={own.key} name={own.title} />}
      <div class="grow">
        <div class="r1">
          <b>{own.title}</b>
          <span class="q">{own.ended > 0 ? clock(own.ended) : ""}</span>
        </div>
        <p class="q cut" title={own.detail}>
          {own.detail}
        </p>
        {own.scores.length > 0 && (
          <table>
            <thead>
              <tr>
                <th>
                  <span class="unseen">criterion</span>
                </th>
                <th class="num">training</th>
                <th class="num">{held ? "held out" : "test"}</th>
              </tr>
            </thead>
            <tbody>
              {own.scores.map((each, k) => (
                <tr>
                  <td class="cut" title={each.criterion}>
                    {each.criterion}
                  </td>
                  <td class="num ink">{numberText(each.training)}</td>
                  <td class="num ink" title={spread(own.spread[k], each.unit)}>
                    {numberText(each.test)}
                  </td>
                </tr>
              ))}
            </tbody>
          </table>
        )}
        {own.remark && (
          <p class="q remark" title={own.remark}>
            {own.remark}
          </p>
        )}
      </div>
    </div>
  );
}

const spread = (value: number | null | undefined, unit: string): string =>
  value === null || value === undefined ? "" : `± ${significant(value, 3)} ${unit} over the folds`;

function FileEntry({ name }: { name: string }) {
  const key = `file:${name}`;
  return (
    <div
      class={`he ${isChosen(key) ? "on" : ""}`}
      data-set={key}
      tabIndex={0}
      onClick={() => choose("second", key)}
      onKeyDown={(event) => keys(event, key)}
    >
      <Badges own={key} name={nameOfSet(key)} />
      <div class="grow">
        <div class="r1">
          <b class="cut" title={name}>
            {name}
          </b>
        </div>
        <p class="q">a file to compare with</p>
      </div>
    </div>
  );
}

function FileChoice() {
  const known = folder.value.files.filter((each) => !files.value.includes(each.name)).map((each) => each.name);
  const add = (name: string): void => {
    files.value = [...files.value, name];
    choose("second", `file:${name}`);
  };
  return (
    <div class="foot">
      <select
        class="field small grow"
        aria-label="Compare with a file"
        value=""
        onChange={(event) => {
          const { value } = event.currentTarget;
          event.currentTarget.value = "";
          if (value) add(value);
        }}
      >
        <option value="">Compare with a file…</option>
        {known.map((name) => (
          <option value={name}>{name}</option>
        ))}
      </select>
      <label class="btn small" title="A calibration file from elsewhere; it is copied beside the project">
        Other…
        <input
          type="file"
          hidden
          onChange={(event) => {
            void addFiles([...(event.currentTarget.files ?? [])]).then((names) => {
              for (const name of names) add(name);
            });
          }}
        />
      </label>
    </div>
  );
}
