// The errors in the header, start to now, and the list of all criteria.

import { effect } from "@preact/signals";
import { overlay } from "./commands";
import { Dialog } from "./dialog";
import { numberText, signed, unitText } from "./drawing/numbers";
import { changeOf, type Line, linesOf, othersText, shortened, shownLines } from "./header-lines";
import type { ScoreRow } from "./replies";
import { onRenewal, scoped } from "./scope";
import { state } from "./store";

const EDIT_SHOWN = 8000; // ms for which the effect of an edit stands in place of the change since the start

const chosen = scoped(""); // the criterion that is shown, of more than two
const edited = scoped(false);
let last = "";
let timer = 0;
onRenewal(() => {
  last = "";
});

effect(() => {
  const { undo, revision, runs } = state.value;
  const now = `${undo} ${revision}`;
  if (now === last) return;
  const first = last === "";
  last = now;
  clearTimeout(timer);
  edited.value = !first && undo !== "" && !/^Run \d+$/.test(undo) && runs.length >= 0;
  if (edited.value)
    timer = window.setTimeout(() => {
      edited.value = false;
    }, EDIT_SHOWN);
});

export function Errors() {
  const lines = linesOf(state.value.scores);
  if (lines.length <= 1) {
    const [own] = lines;
    return (
      <div class="errbox" title={own?.criterion}>
        <table class="errs" aria-label="RMSE">
          <tbody>
            <tr>
              <td class="lab">RMSE training</td>
              <Cells own={own?.training ?? null} id="rmse-training" />
            </tr>
            <tr>
              <td class="lab">RMSE test</td>
              <Cells own={own?.test ?? null} id="rmse-test" />
            </tr>
          </tbody>
        </table>
      </div>
    );
  }
  const shown = shownLines(lines, chosen.value);
  return (
    <div class="errbox">
      <table class="errs" aria-label="RMSE">
        <tbody>
          {shown.map((line, k) => (
            <Row key={line.criterion} line={line} first={k === 0} />
          ))}
          {lines.length > 2 && (
            <tr>
              <td colSpan={10}>
                <button
                  class="link"
                  id="more-errors"
                  onClick={() => {
                    overlay.value = "errors";
                  }}
                >
                  {othersText(lines, shown[0]!)}
                </button>
              </td>
            </tr>
          )}
        </tbody>
      </table>
    </div>
  );
}

function Row({ line, first }: { line: Line; first: boolean }) {
  return (
    <tr>
      <td class="nm" title={line.criterion}>
        {shortened(line.criterion, 14)}
      </td>
      <td class="lab tr">training</td>
      <Cells own={line.training} id={first ? "rmse-training" : undefined} />
      <td class="lab">test</td>
      <Cells own={line.test} id={first ? "rmse-test" : undefined} />
    </tr>
  );
}

function Cells({ own, id }: { own: ScoreRow | null; id: string | undefined }) {
  const { rmse = null, before = null, last: earlier = null, unit = "" } = own ?? {};
  return (
    <>
      <td class="from">{own === null ? "" : `${numberText(before)} →`}</td>
      <td class="rv" id={id} title={own === null ? undefined : `start ${numberText(before)} ${unit}`}>
        <b>{numberText(rmse)}</b>
        {rmse !== null && unitText(unit) && <span class="u"> {unit}</span>}
      </td>
      <Change rmse={rmse} before={before} last={earlier} />
    </>
  );
}

function Change({ rmse, before, last: earlier }: Record<"rmse" | "before" | "last", number | null>) {
  const share = rmse !== null && before ? (rmse / before - 1) * 100 : null;
  const sinceStart = share === null || Math.abs(share) < 0.05 ? "" : `${signed(share, 3)} %`;
  if (edited.value && rmse !== null && earlier !== null) {
    const by = changeOf(earlier, rmse);
    const kind = by === 0 ? "q" : by > 0 ? "bad" : "good";
    return (
      <td class={`d ${kind}`} title={`Change by the last edit; since the start ${sinceStart || "none"}`}>
        edit {by === 0 ? "0" : signed(by, 3)}
      </td>
    );
  }
  return (
    <td class={`d ${(share ?? 0) > 0 ? "bad" : "good"}`} title="Change since the start">
      {sinceStart}
    </td>
  );
}

/** All criteria; the header shows the one that is chosen. */
export function ErrorList() {
  const close = (): void => {
    overlay.value = "";
  };
  const lines = linesOf(state.value.scores);
  const [shown] = shownLines(lines, chosen.value);
  return (
    <Dialog label="Errors of all criteria" kind="errors" close={close}>
      <div class="head">
        <h2>RMSE of all criteria</h2>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>criterion</th>
            <th class="num">start</th>
            <th class="num">training</th>
            <th class="num">test</th>
            <th>
              <span class="unseen">unit</span>
            </th>
            <th class="num">last edit</th>
          </tr>
        </thead>
        <tbody>
          {lines.map(({ criterion, training, test }) => (
            <tr key={criterion} class={criterion === shown?.criterion ? "on" : ""} data-criterion={criterion}>
              <td>
                <button
                  class="link"
                  data-first={criterion === shown?.criterion ? true : undefined}
                  onClick={() => {
                    chosen.value = criterion;
                    close();
                  }}
                >
                  {criterion}
                </button>
              </td>
              <td class="num">{numberText(training?.before)}</td>
              <td class="num ink">{numberText(training?.rmse)}</td>
              <td class="num ink">{numberText(test?.rmse)}</td>
              <td class="q">{unitText(training?.unit ?? test?.unit ?? "")}</td>
              <td class="num">
                {training?.rmse != null && training.last != null && changeOf(training.last, training.rmse) !== 0
                  ? signed(changeOf(training.last, training.rmse), 3)
                  : "0"}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </Dialog>
  );
}
