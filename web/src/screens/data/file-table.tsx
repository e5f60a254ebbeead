// The files: their use, what they are like, and their errors.

import { chosenFile, entries, errorLines, errors, errorsOf } from "../../data-files";
import { line, type Pen } from "../../drawing/canvas";
import { token } from "../../drawing/colours";
import { count, counted, MISSING, numberText, plain, significant, unitText } from "../../drawing/numbers";
import { pairPositions } from "../../drawing/strips";
import { addFiles } from "../../dropping";
import { NumberField, Segment, TextField } from "../../fields";
import { Icon } from "../../icons";
import { Picture } from "../../instruments/picture";
import { SettingsButton } from "../../instruments/settings-panel";
import { openEntry, panel } from "../../navigation";
import type { DatasetFiles, FileRow, RecordingFile } from "../../replies";
import { setKeys } from "../../settings";
import { settled } from "../../store";

export function FileTable() {
  const all = entries.value;
  const used = all.filter((each) => each.use !== "off").reduce((sum, each) => sum + each.files.length, 0);
  const off = all.reduce((sum, each) => sum + each.files.length, 0) - used;
  const known = settled.value.datasets.reduce((sum, each) => sum + each.samples, 0);
  const listed = all.filter((each) => each.use !== "off").flatMap((each) => each.files);
  // a project with errors has no datasets, but its files have samples
  const samples = known || listed.reduce((sum, each) => sum + (each.samples ?? 0), 0);
  const unit = unitText(errors.value?.unit ?? "");
  return (
    <section class="pane files">
      <div class="head">
        <h2>Files</h2>
        <span class="sub">
          {counted(used, "file")} in {counted(all.filter((each) => each.use !== "off").length, "dataset")}
          {off > 0 ? `, ${off} off` : ""} · {counted(samples, "sample")}
        </span>
        <span class="right">
          <DatasetFields />
          <SettingsButton own={panel.data} first="dataset" />
          <label class="btn small">
            <Icon name="plus" />
            Add files
            <input type="file" multiple hidden onChange={(event) => addFiles([...(event.currentTarget.files ?? [])])} />
          </label>
          <span class="q wide">or drop them</span>
        </span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>file</th>
            <th>dataset</th>
            <th>use</th>
            <th class="num">weight</th>
            <th class="num">samples</th>
            <th class="num">rate</th>
            <th class="num">length</th>
            <th>gaps, missing</th>
            <th class="num">RMSE start</th>
            <th class="num">now</th>
            <th>worst stretch</th>
            <th class="num">there</th>
            <th>
              error, ± {errors.value ? significant(1.5 * errors.value.reach, 2) : MISSING} {unit}
            </th>
            <th>
              <span class="unseen">remove</span>
            </th>
          </tr>
        </thead>
        <tbody>
          {all.map((entry) => entry.files.map((file, k) => <Row entry={entry} file={file} first={k === 0} />))}
        </tbody>
      </table>
      {all.length === 0 && (
        <p class="pad q">
          Recordings to calibrate with: MDF, CSV, Excel, Parquet, MATLAB or logger files. Drop them here.
        </p>
      )}
    </section>
  );
}

/** What holds for the dataset of the chosen file. */
function DatasetFields() {
  const row = errors.value?.files[chosenFile.value];
  const number = settled.value.datasets[row?.dataset ?? 0]?.number ?? entries.value[0]?.number;
  const entry = entries.value.find((each) => each.number === number);
  if (entry === undefined) return null;
  const name = entry.name || settled.value.datasets.find((each) => each.number === number)?.name || "";
  const at = entry.number;
  return (
    <span class="row" title={`Of dataset ${name}`}>
      <span class="q cut name">{name}</span>
      <span class="q">where</span>
      <TextField
        path={["dataset", at, "where"]}
        label={`Condition of ${name}`}
        placeholder="all samples"
        width={100}
        mono
      />
      <span class="q">raster</span>
      <NumberField path={["dataset", at, "raster"]} label={`Raster of ${name}`} placeholder="own" width={54} />
      <span class="q">warm-up</span>
      <NumberField path={["dataset", at, "warmup"]} label={`Warm-up of ${name}`} width={46} />
    </span>
  );
}

function Row({ entry, file, first }: { entry: DatasetFiles; file: RecordingFile; first: boolean }) {
  const at = entry.number;
  const own = settled.value.datasets.find((each) => each.number === at);
  const [row, number] = errorsOf(entry, file) ?? [undefined, -1];
  const on = row !== undefined && number === chosenFile.value;
  const set = (use: string) =>
    setKeys([[["dataset", at, "use"], use === "training" ? null : use]], `${file.name}: ${use}`);
  return (
    <tr
      class={`${entry.use === "off" ? "off" : ""} ${on ? "on" : ""}`}
      data-file={file.name}
      tabIndex={0}
      onClick={() => {
        if (row !== undefined) chosenFile.value = number;
      }}
      onKeyDown={(event) => {
        const use = { t: "training", v: "test", o: "off" }[event.key];
        if (use === undefined || event.target !== event.currentTarget) return;
        event.preventDefault();
        void set(use);
      }}
    >
      <td>
        <Icon name="file" /> <b title={file.name}>{file.name}</b>
      </td>
      <td>
        {first && (
          <button
            class="fold link"
            title="All settings of the dataset"
            onClick={() => {
              panel.data.value = "dataset";
              openEntry("dataset", at);
            }}
          >
            {entry.name || own?.name || MISSING}
          </button>
        )}
      </td>
      <td>
        {first && (
          <Segment
            label={`Use of ${file.name}`}
            options={["training", "test", "off"]}
            chosen={entry.use}
            choose={(use) => void set(use)}
          />
        )}
      </td>
      <td class="num">
        {first && <NumberField path={["dataset", at, "weight"]} label={`Weight of ${file.name}`} width={40} />}
      </td>
      {file.error ? (
        <td colSpan={9} class="bad fault">
          {file.error}
        </td>
      ) : file.note ? (
        <td colSpan={9} class="q">
          {file.note}
        </td>
      ) : (
        <>
          <td class="num">{count(file.samples ?? 0)}</td>
          <Rate own={file} />
          <td class="num">{file.length ? `${significant(file.length, 4)} s` : MISSING}</td>
          <td>
            <Gaps file={file} row={row} />
          </td>
          <Errors row={row} number={number} />
        </>
      )}
      <td>
        {first && (
          <button
            class="btn bare small"
            title="Remove the dataset from the project; the file stays"
            aria-label={`Remove ${file.name}`}
            onClick={() => setKeys([[["dataset", at], null]], `Removed ${entry.name || file.name}`)}
          >
            ×
          </button>
        )}
      </td>
    </tr>
  );
}

/** Stretches that the function cannot run over, and the channel that lacks most. */
function Gaps({ file, row }: { file: RecordingFile; row: FileRow | undefined }) {
  const [gaps, length] = row?.gaps ?? [0, 0];
  const most = file.missing ? `${(file.missing * 100).toFixed(1)} % of ${file.sparsest ?? "a channel"} missing` : "";
  if (gaps > 0)
    return (
      <span class="tag w" title={`Channels that the function reads are missing there.\n${most}`}>
        {counted(gaps, "gap")}, {plain(length, 3)} {row!.timed ? "s" : "samples"}
      </span>
    );
  return most ? (
    <span class="tag w" title={most}>
      {(file.missing! * 100).toFixed(1)} %
    </span>
  ) : (
    <span class="q">none</span>
  );
}

function Errors({ row, number }: { row: FileRow | undefined; number: number }) {
  if (row === undefined)
    return (
      <>
        <td class="num">{MISSING}</td>
        <td class="num">{MISSING}</td>
        <td>{MISSING}</td>
        <td class="num">{MISSING}</td>
        <td />
      </>
    );
  const worst = row.worst;
  const points = errorLines.value?.[String(number)];
  return (
    <>
      <td class="num">{numberText(row.before)}</td>
      <td class="num">
        <b>{numberText(row.rmse)}</b>
      </td>
      <td>{worst ? `${plain(worst[0], 5)} … ${plain(worst[1], 5)}${row.timed ? " s" : ""}` : MISSING}</td>
      <td class="num">{worst ? significant(worst[2]) : MISSING}</td>
      <td class="line">
        <Picture
          label={`Error of ${row.name}`}
          kind="spark"
          draw={(pen, wide, high) => drawError(pen, wide, high, points, errors.value?.reach ?? 1)}
          of={[points, errors.value?.reach]}
        />
      </td>
    </>
  );
}

function drawError(pen: Pen, wide: number, high: number, points: Float32Array | undefined, reach: number): void {
  if (points === undefined || points.length < 4) return;
  const most = 1.5 * reach; // room around the extremes of many samples in a pixel
  const ys = Float64Array.from(points, (y) => high / 2 - (Math.max(-most, Math.min(most, y)) / most) * (high / 2 - 1));
  line(pen, pairPositions(points, 0, wide), ys, token("error"), 1);
}

/** The rate of a file; of several groups of channels, the lowest and the highest. */
function Rate({ own }: { own: RecordingFile }) {
  const hertz = (step: number): string => plain(1 / step, 3);
  const steps = own.groups.map((each) => each.step).filter((step) => step > 0);
  const slowest = steps.length > 0 ? hertz(Math.max(...steps)) : "";
  const fastest = own.step ? hertz(own.step) : "";
  return (
    <td class="num" title={own.groups.map((each) => `${each.name} every ${significant(each.step, 3)} s`).join("\n")}>
      {fastest === "" ? MISSING : `${slowest && slowest !== fastest ? `${slowest} … ` : ""}${fastest} Hz`}
    </td>
  );
}
