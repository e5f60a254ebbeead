// Rounding: the step of each label, the errors before and after, and which label would profit from finer storage.

import {
  busy,
  chooseMethod,
  finer,
  type Method,
  method,
  round,
  rounded,
  roundingStale,
  rounds,
  setSteps,
  setStorage,
  source,
} from "../../control-unit";
import { counted, MISSING, numberText, significant, unitText } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import { NumberInput } from "../../inputs";
import type { ControlUnit, FinerRow, RoundedError, RoundedLabel, StorageRow } from "../../replies";
import { failure, state } from "../../store";

const ENOUGH = 0.05; // share of the loss, below which finer storage of a label is not worth a word

export function RoundingPane({ own }: { own: ControlUnit }) {
  const reply = rounded.value;
  return (
    <section class="pane rounding" aria-label="Rounding">
      <div class="head">
        <h2>Rounding</h2>
        <SourceChoice />
        {roundingStale.value ? (
          <span class="sub warn" id="rounding-stale">
            older than the values
          </span>
        ) : (
          <span class="sub">{reply && rounds.value ? facts() : "to the steps in which values are stored"}</span>
        )}
        <span class="right">
          <Segment
            label="Method"
            options={["nearest", "joint"]}
            chosen={method.value}
            choose={(option) => chooseMethod(option as Method)}
          />
          <button
            class="btn small primary"
            id="round"
            disabled={!rounds.value || busy.value !== ""}
            title={rounds.value ? "Round the values; nothing is changed or written (r)" : "Type a step first"}
            onClick={() => void round()}
          >
            {roundingStale.value ? "Round again" : "Round"}
          </button>
        </span>
      </div>
      {rounds.value && reply !== null && <Errors />}
      {!rounds.value && <Missing own={own} />}
      <div class="labels">
        <table class="list rd" id="storage">
          <thead>
            <tr>
              <th>label</th>
              <th class="num" title="Distance of storable values">
                step
              </th>
              <th>
                <span class="unseen">unit</span>
              </th>
              <th title="Bits of a stored number">storage</th>
              <th
                class="num"
                title="Share of what rounding costs, that storage without steps of this label alone saves"
              >
                share
              </th>
              <th class="num" title="Values that are not the storable ones nearest to the fit">
                not nearest
              </th>
              <th class="num" title="The largest distance from the fit">
                moved, most
              </th>
              <th title="The RMSE of the first row if this label alone were stored in finer steps">if finer</th>
            </tr>
          </thead>
          <tbody>
            {own.rows.map((row) => (
              <LabelLine key={row.name} row={row} label={labelOf(row.name)} />
            ))}
            {(reply?.labels ?? [])
              .filter((each) => !own.rows.some((row) => row.name === each.name))
              .map((each) => (
                <AxisLine key={each.name} own={each} />
              ))}
          </tbody>
        </table>
        {own.count > own.rows.length && <p class="pad q">{own.count - own.rows.length} more labels</p>}
        {rounds.value && reply !== null && <Advice own={own} />}
        {rounds.value && reply !== null && finer.value.length > 0 && <FinerTable />}
        {reply?.findings.map((text) => (
          <p class="note warn">{text}</p>
        ))}
        <Storage own={own} />
      </div>
    </section>
  );
}

function facts(): string {
  const reply = rounded.value!;
  const values = reply.labels.reduce((sum, each) => sum + each.values, 0);
  const size = reply.size === null ? "" : `, ${reply.size} bytes`;
  const run = reply.run ? `the fit of run ${reply.run}, ` : "";
  return `${run}${counted(values, "value")}${size} in ${reply.seconds.toFixed(2)} s`;
}

const labelOf = (name: string): RoundedLabel | undefined =>
  rounds.value ? rounded.value?.labels.find((each) => each.name === name) : undefined;

/** Which values are rounded and written. */
function SourceChoice() {
  return (
    <select
      class="field small"
      aria-label="Values"
      title="The values that are rounded and written"
      value={source.value}
      onChange={(event) => {
        source.value = event.currentTarget.value;
      }}
    >
      <option value="now">present values</option>
      {state.value.runs.map((run) => (
        <option value={String(run.number)}>run {run.number}</option>
      ))}
      <option value="start">start</option>
    </select>
  );
}

function Missing({ own }: { own: ControlUnit }) {
  return (
    <div class="note" id="no-steps">
      <span class="grow">
        No step is known, and values are written as they are. Type the step of a label below
        {own.descriptions.length > 0 || own.image ? ", or take the storage from an A2L file" : ""}: rounding all values
        together loses less than rounding each to the nearest.
      </span>
      {own.image && (
        <button class="btn small" onClick={() => void setStorage("")}>
          Use the A2L file of the image
        </button>
      )}
    </div>
  );
}

function Errors() {
  const { errors } = rounded.value!;
  return (
    <table class={`errors ${roundingStale.value ? "old" : ""}`} id="rounding-errors">
      <thead>
        <tr>
          <th>RMSE</th>
          <th>
            <span class="unseen">data</span>
          </th>
          <th class="num">unrounded</th>
          <th class="num" title="Each value rounded to the nearest">
            nearest
          </th>
          <th class="num" title="All values rounded together, so that their errors cancel">
            joint
          </th>
          <th>
            <span class="unseen">change</span>
          </th>
          <th class="num" title="Share of the loss of rounding to the nearest that joint rounding regains">
            regained
          </th>
        </tr>
      </thead>
      <tbody>
        {errors.map((each) => (
          <tr data-error={`${each.criterion}/${each.dataset}`}>
            <td class="cut" title={`${each.criterion} on ${each.dataset}`}>
              <b>{each.criterion}</b> <span class="q">{each.dataset}</span>
            </td>
            <td class="q">{each.use}</td>
            <td class="num">
              <b>{numberText(each.unrounded)}</b>
            </td>
            <td class={`num ${method.value === "nearest" ? "applied bad" : "bad"}`}>{numberText(each.nearest)}</td>
            <td class={`num ${method.value === "joint" ? "applied good" : "good"}`}>{numberText(each.joint)}</td>
            <td class="q">{unitText(each.unit)}</td>
            <td class="num q">{regained(each)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function regained({ unrounded, nearest, joint }: RoundedError): string {
  if (unrounded === null || nearest === null || joint === null || nearest - unrounded < 1e-3 * unrounded) return "";
  return joint <= unrounded ? "all" : `${Math.round((100 * (nearest - joint)) / (nearest - unrounded))} %`;
}

const bitsOf = (bits: number): string => (bits ? `${bits} bit` : "");

function LabelLine({ row, label }: { row: StorageRow; label: RoundedLabel | undefined }) {
  return (
    <tr data-label={row.name} class={label && rounded.value?.advice === row.name ? "on" : ""}>
      <td class="cut" title={row.name}>
        <b>{row.name}</b>
      </td>
      <td class="num">
        <span
          class={`field small num ${row.typed === null ? "empty" : ""}`}
          style={{ width: "74px" }}
          title={range(row)}
        >
          <NumberInput
            label={`Step of ${row.name}`}
            placeholder={row.step === null ? "none" : String(row.step)}
            own={row.typed ?? undefined}
            enter={(value, text) => {
              if (value === null || typeof value === "number") void setSteps({ [row.name]: value });
              else failure.value = `The step of ${row.name} must be a number, got '${text}'`;
            }}
          />
        </span>
      </td>
      <td class="q">{unitText(row.unit)}</td>
      <td class="q cut" title={row.reason || range(row)}>
        {row.reason ? (row.step === null ? "as it is" : row.reason) : bitsOf(row.bits) || "typed"}
      </td>
      <Shares own={label} />
      <td class="q">{label ? worth(row.name, label) : ""}</td>
    </tr>
  );
}

function AxisLine({ own }: { own: RoundedLabel }) {
  return (
    <tr data-label={own.name}>
      <td class="cut" title={`Breakpoints of ${own.name}`}>
        <b>{own.name}</b>
      </td>
      <td class="num">{significant(own.step, 6)}</td>
      <td />
      <td class="q">{bitsOf(own.bits) || "breakpoints"}</td>
      <Shares own={own} />
      <td />
    </tr>
  );
}

function Shares({ own }: { own: RoundedLabel | undefined }) {
  if (own === undefined)
    return (
      <>
        <td />
        <td />
        <td />
      </>
    );
  return (
    <>
      <td class="num ink">{own.share === null ? MISSING : `${Math.round(100 * own.share)} %`}</td>
      <td class="num">
        {own.moved} <span class="q">of {own.values}</span>
      </td>
      <td class="num">{own.largestShift === null ? MISSING : `${own.largestShift.toFixed(1)} steps`}</td>
    </>
  );
}

function range(row: StorageRow): string {
  if (row.reason) return `${row.name} is not rounded: ${row.reason}`;
  if (row.least === null || row.largest === null) return "Distance of storable values";
  return `${bitsOf(row.bits)}: ${significant(row.least, 6)} to ${significant(row.largest, 6)} ${unitText(row.unit)}`;
}

function worth(name: string, label: RoundedLabel): string {
  const [first] = finer.value;
  const alone = first !== undefined && Object.keys(first.steps).length === 1 ? first : undefined;
  if (alone?.steps[name] !== undefined) return `${result(alone)} in all`;
  if (label.share !== null && label.share < ENOUGH) return "enough";
  return rounded.value!.trials.length === 0 && rounded.value!.advice === "" ? "enough" : "";
}

/** The error of the first criterion on its first data, by the present method. */
function result(own: FinerRow): string {
  const [error] = own.errors;
  return error === undefined ? MISSING : `${numberText(error[method.value])} ${unitText(error.unit)}`;
}

function Advice({ own }: { own: ControlUnit }) {
  const reply = rounded.value!;
  const [first] = finer.value;
  const [error] = reply.errors;
  if (reply.advice === "")
    return (
      <div class="note good" id="advice">
        <Icon name="done" />
        <span class="grow">The steps are fine enough, or all labels share what rounding costs.</span>
      </div>
    );
  if (first === undefined || error === undefined || first.steps[reply.advice] === undefined)
    return (
      <div class="note warn" id="advice">
        <Icon name="warning" />
        <span class="grow">
          <b>{reply.advice}</b> would profit most from finer storage.
        </span>
      </div>
    );
  const bytes = first.size !== null && reply.size !== null ? ` for ${first.size - reply.size} bytes more` : "";
  const [step] = Object.values(first.steps);
  const unit = own.rows.find((row) => row.name === reply.advice)?.unit ?? "";
  return (
    <div class="note warn" id="advice">
      <Icon name="warning" />
      <span class="grow">
        One label decides: <b>{reply.advice}</b> in {first.bits ? "16 bit" : "steps of 1/256"} takes the RMSE of{" "}
        {error.criterion} on {error.dataset} from {numberText(error[method.value])} to {result(first)}
        {bytes}.
      </span>
      <button class="btn small" id="use-finer" onClick={() => void setSteps(first.steps)}>
        Use a step of {significant(step!, 3)} {unitText(unit)}
      </button>
    </div>
  );
}

function FinerTable() {
  const { errors, size } = rounded.value!;
  const [error] = errors;
  if (error === undefined) return null;
  const lines = [{ name: "as it is stored", error, size, steps: null as FinerRow["steps"] | null }].concat(
    finer.value.map((each) => ({
      name: names(each),
      error: each.errors[0] ?? error,
      size: each.size,
      steps: each.steps,
    })),
  );
  return (
    <table class="list rd" id="finer">
      <thead>
        <tr>
          <th>
            RMSE of {error.criterion} on {error.dataset} with finer steps for
          </th>
          <th class="num">nearest</th>
          <th class="num">joint</th>
          <th class="num">bytes</th>
          <th>
            <span class="unseen">take</span>
          </th>
        </tr>
      </thead>
      <tbody>
        {lines.map((line) => (
          <tr>
            <td class="cut" title={line.steps === null ? undefined : Object.keys(line.steps).join(", ")}>
              {line.name}
            </td>
            <td class="num bad">{numberText(line.error.nearest)}</td>
            <td class="num good">{numberText(line.error.joint)}</td>
            <td class="num">{line.size ?? MISSING}</td>
            <td class="num">
              {line.steps !== null && (
                <button class="btn small" onClick={() => void setSteps(line.steps!)}>
                  Use
                </button>
              )}
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function names(own: FinerRow): string {
  const all = Object.keys(own.steps);
  return all.length > 2 ? `all ${all.length}` : all.join(" and ");
}

function Storage({ own }: { own: ControlUnit }) {
  if (own.descriptions.length === 0 && own.storage === "") return null;
  const known = own.storage && !own.descriptions.includes(own.storage) ? [own.storage] : [];
  return (
    <label class="pad storage">
      <span class="q">storage of the labels</span>
      <select
        class="field small"
        aria-label="Storage"
        value={own.storage}
        onChange={(event) => void setStorage(event.currentTarget.value)}
      >
        <option value="">{own.image ? "as the image" : "no A2L file"}</option>
        {[...known, ...own.descriptions].map((each) => (
          <option value={each}>{each}</option>
        ))}
      </select>
      <span class="q">a typed step precedes it</span>
    </label>
  );
}
