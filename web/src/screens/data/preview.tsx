// One channel and the error over all files, the distribution of the errors, and the error over the shift.

import {
  addShift,
  chosenFile,
  errorLines,
  errors,
  preview,
  type Scan,
  scanShift,
  scans,
  shownChannel,
} from "../../data-files";
import { distinctNames } from "../../data-names";
import { area, type Box, extent, line, type Pen, type Range, widened } from "../../drawing/canvas";
import { css, family, token } from "../../drawing/colours";
import { dots, rules } from "../../drawing/marks";
import { counted, MISSING, plain, significant, unitText, withUnit } from "../../drawing/numbers";
import { pairPositions } from "../../drawing/strips";
import { nearestTo, type Read } from "../../hover-tip";
import { CriterionChoice } from "../../instruments/criterion-choice";
import { Picture } from "../../instruments/picture";
import { showDataset, stretch } from "../../plots";
import type { FileRow } from "../../replies";
import { blocking, screen } from "../../store";

const LEFT = 60;
const RIGHT = 16; // half of the last number of an axis
const HEAD = 18; // of the names of the files

export function Preview() {
  const own = errors.value;
  const facts = preview.value?.signals[0];
  return (
    <section class="pane allfiles" aria-label="Preview over all files">
      <div class="head">
        <h2 class="cut">{shownChannel.value || "Preview"}</h2>
        <span class="sub cut">
          {[unitText(facts?.unit ?? ""), "all files", own ? `with the error of ${own.criterion}` : ""]
            .filter(Boolean)
            .join(" · ")}
        </span>
        <span class="right">
          <CriterionChoice />
          <span class="key">
            <i style={{ background: "var(--accent-soft)" }} />
            training
          </span>
          <span class="key">
            <i style={{ background: "var(--raise)" }} />
            test
          </span>
          <span class="key">
            <i style={{ background: "var(--warn-soft)" }} />
            gap, worst stretch
          </span>
        </span>
      </div>
      {facts?.missing || blocking.value !== null ? (
        <p class="pad q">
          {facts?.missing || "All files are drawn here, one after the other, once the project can be evaluated."}
        </p>
      ) : (
        <Picture
          label={`${shownChannel.value} and the error over all files; a click shows the worst stretch in Plots`}
          kind="filling"
          draw={drawPreview}
          of={[own, errorLines.value, preview.value, chosenFile.value]}
        />
      )}
    </section>
  );
}

function drawPreview(pen: Pen, width: number, height: number): Read | undefined {
  const files = errors.value?.files ?? [];
  if (files.length === 0) return undefined;
  const lines = preview.value?.lines ?? {};
  const channel = files.map((_, k) => lines[`0 ${k}`] ?? new Float32Array());
  const error = files.map((_, k) => errorLines.value?.[String(k)] ?? new Float32Array());
  const reach = errors.value?.reach || 1;
  const middle = HEAD + (height - HEAD - 34) * 0.62;
  const each = (width - LEFT - RIGHT) / files.length;
  const ranges: [Range, Range] = [widened(extent(...channel), 0.06), [-reach * 1.1, reach * 1.1]];
  const gaps = preview.value?.signals[0]?.gaps ?? {};
  const short = distinctNames(files.map((each) => each.name));
  files.forEach((file, k) => {
    const [left, right] = [LEFT + k * each, LEFT + (k + 1) * each - (k + 1 < files.length ? 2 : 0)];
    drawHead(pen, file, short[k]!, left, right, k === chosenFile.value);
    const boxes: [Box, Box] = [
      { left, right, top: HEAD + 4, bottom: middle - 4 },
      { left, right, top: middle + 4, bottom: height - 34 },
    ];
    const span: Range = [0, Math.max(file.end - file.begin, 1e-9)];
    boxes.forEach((box, row) => {
      const last = row === 1;
      const plot = area(pen, box, span, ranges[row]!, {
        unlabelled: !last || each < 60,
        unlabelledY: k > 0,
        title: last && k + 1 === files.length ? (file.timed ? "time in each file [s]" : "sample in each file") : "",
        yTitle:
          k > 0
            ? ""
            : row === 0
              ? withUnit(shownChannel.value, preview.value?.signals[0]?.unit ?? "")
              : withUnit("error", errors.value?.unit ?? ""),
      });
      plot.clip(() => {
        const shade = (from: number, to: number, colour: string) => {
          pen.fillStyle = colour;
          pen.fillRect(plot.x(from), box.top, Math.max(2, plot.x(to) - plot.x(from)), box.bottom - box.top);
        };
        if (row === 0)
          for (const [from, to] of gaps[k] ?? []) shade(from - file.begin, to - file.begin, token("warn-soft"));
        else if (file.worst) shade(...worstOf(file), token("warn-soft"));
        const points = (row === 0 ? channel : error)[k]!;
        const xs = pairPositions(points, left, right);
        line(pen, xs, Float64Array.from(points, plot.y), token(row === 0 ? "measured" : "error"), 1);
      });
    });
  });
  return (x) => {
    const k = Math.floor((x - LEFT) / each);
    const file = files[k];
    if (file === undefined || x < LEFT) return null;
    const share = Math.min(1, (x - LEFT - k * each) / each);
    const time = share * (file.end - file.begin);
    return [
      rangeText(shownChannel.value, channel[k]!, share, preview.value?.signals[0]?.unit ?? ""),
      rangeText("error", error[k]!, share, errors.value?.unit ?? ""),
      `${file.name} ${file.timed ? `at ${plain(time, 4)} s` : `sample ${Math.round(time) + 1}`}`,
    ];
  };
}

/** What a line of pairs, the least and the greatest value of a pixel each, has at a share of its length. */
function rangeText(name: string, pairs: Float32Array, share: number, unit: string): string {
  const k = 2 * Math.round(share * Math.max(0, pairs.length / 2 - 1));
  const [low, high] = [pairs[k] ?? NaN, pairs[k + 1] ?? NaN];
  if (!Number.isFinite(low)) return `${name} ${MISSING}`;
  return `${name} ${significant(low)}${high > low ? ` … ${significant(high)}` : ""} ${unitText(unit)}`.trim();
}

/** Begin and end of the worst stretch, counted from the begin of the file. */
const worstOf = (file: FileRow): [number, number] =>
  file.timed ? [file.worst![0] - file.begin, file.worst![1] - file.begin] : [file.worst![0] - 1, file.worst![1]];

function drawHead(pen: Pen, file: FileRow, own: string, left: number, right: number, on: boolean): void {
  pen.fillStyle = token(file.use === "training" ? "accent-soft" : "raise");
  pen.fillRect(left, 0, right - left - 1, HEAD - 3);
  pen.fillStyle = token(on ? "accent" : "text");
  pen.textBaseline = "middle";
  const room = right - left - 10;
  const fits = (text: string): boolean => pen.measureText(text).width <= room;
  let text = [`${file.name}  ${file.use}`, file.name, own].find(fits) ?? own;
  while (text.length > 2 && !fits(text)) text = `${text.slice(0, -2)}…`;
  if (right - left > 24) pen.fillText(text, left + 5, HEAD / 2 - 1);
  pen.textBaseline = "alphabetic";
}

/** Show the worst stretch of a file in the plots. */
function showWorst(file: FileRow): void {
  showDataset(file.dataset);
  if (file.worst !== null && file.timed) {
    const [begin, end] = file.worst;
    stretch.value = { begin: begin - (end - begin), end: end + (end - begin) };
  }
  screen.value = "plots";
}

export function SidePane() {
  const scan = scans.value[shownChannel.value];
  return scan === undefined ? <ErrorPane /> : <ShiftPane scan={scan} />;
}

/** The distribution of the errors by file, on the same bins. */
function ErrorPane() {
  const own = errors.value;
  const file = own?.files[chosenFile.value];
  return (
    <section class="pane judged" aria-label="Errors by file">
      <div class="head">
        <h2>Errors</h2>
        <span class="sub cut">{file ? `${file.name} and all files` : "by file"}</span>
      </div>
      {own === null && blocking.value !== null && <p class="pad q">The errors of each file.</p>}
      <Picture
        label="Histogram of the errors of the chosen file and of all files"
        kind="filling"
        draw={drawHistogram}
        of={[own, errorLines.value, chosenFile.value]}
      />
      <div class="foot">
        <span class="grow q">
          {file && file.rmse !== null
            ? `RMSE ${significant(file.rmse)}, largest ${significant(file.largest ?? 0)} ${unitText(own!.unit)} of ${counted(file.samples, "sample")}`
            : ""}
        </span>
        <button class="btn small" disabled={!file?.worst} onClick={() => showWorst(file!)}>
          Worst stretch
        </button>
      </div>
    </section>
  );
}

function drawHistogram(pen: Pen, width: number, height: number): Read | undefined {
  const own = errors.value;
  const lines = errorLines.value;
  if (own === null || lines === null) return undefined;
  const shares = own.files.map((_, k) => {
    const counts = lines[`bins ${k}`] ?? new Float32Array();
    const total = counts.reduce((sum, each) => sum + each, 0) || 1;
    return Float64Array.from(counts, (each) => (100 * each) / total);
  });
  const box = { left: LEFT - 12, right: width - 12, top: 10, bottom: height - 36 };
  const most = Math.max(1, extent(...shares)[1]);
  const plot = area(pen, box, [-own.reach, own.reach], [0, most * 1.08], {
    title: withUnit(`error of ${own.criterion}`, own.unit),
    yTitle: "",
  });
  plot.clip(() => {
    shares.forEach((each, k) => {
      if (k !== chosenFile.value)
        drawSteps(
          pen,
          plot,
          each,
          own.reach,
          shares.length > 8 ? token("before") : css(family(k / Math.max(1, shares.length - 1)), 0.6),
          shares.length > 8 ? 0.6 : 1,
        );
    });
    const chosen = shares[chosenFile.value];
    if (chosen) drawSteps(pen, plot, chosen, own.reach, token("error"), 2);
    rules(pen, plot, "x", [0], token("quiet"), [3, 3]);
  });
  pen.fillStyle = token("quiet");
  pen.fillText("% of its samples", box.left + 5, box.top + 12);
  return (x) => {
    const bins = shares[0]?.length ?? 0;
    const k = Math.floor(((plot.xAt(x) + own.reach) / (2 * own.reach)) * bins);
    if (k < 0 || k >= bins) return null;
    const edge = (at: number): string => plain(-own.reach + (2 * own.reach * at) / bins, 3);
    const order = [chosenFile.value, ...own.files.keys()].filter((each, at) => at === 0 || each !== chosenFile.value);
    return [
      ...order.slice(0, 8).map((each) => `${own.files[each]!.name} ${significant(shares[each]![k]!, 3)} %`),
      `error ${edge(k)} … ${edge(k + 1)} ${unitText(own.unit)}`.trim(),
    ];
  };
}

function drawSteps(
  pen: Pen,
  plot: ReturnType<typeof area>,
  shares: ArrayLike<number>,
  reach: number,
  colour: string,
  width: number,
): void {
  const edges = Array.from({ length: shares.length + 1 }, (_, k) => -reach + (2 * reach * k) / shares.length);
  const xs = edges.flatMap((edge, k) => (k === 0 || k === shares.length ? [edge] : [edge, edge])).map(plot.x);
  const ys = Array.from(shares)
    .flatMap((each) => [each, each])
    .map(plot.y);
  line(pen, xs, ys, colour, width);
}

/** The error over the shift of the channel, with the present values. */
function ShiftPane({ scan }: { scan: Scan }) {
  const channel = shownChannel.value;
  const late = scan.best < 0;
  const digits = plain(Math.abs(scan.best), 3);
  const next = Number(scan.best.toPrecision(3));
  return (
    <section class="pane judged" aria-label={`Shift of ${channel}`}>
      <div class="head">
        <h2 class="cut">Shift of {channel}</h2>
        <span class="sub">RMSE over the shift</span>
        <button
          class="btn bare small right"
          aria-label="Close"
          onClick={() => {
            const { [channel]: _, ...others } = scans.value;
            scans.value = others;
          }}
        >
          ×
        </button>
      </div>
      <Picture
        label={`RMSE over the shift of ${channel}`}
        kind="filling"
        draw={(pen, wide, high) => drawScan(pen, wide, high, scan)}
        of={[scan]}
      />
      <div class="foot">
        <span class="grow">
          {scan.seen ? (
            <>
              Recorded <b>{digits} s</b> {late ? "late" : "early"}
              {scan.atTheEnd ? ", or more" : ""}.{" "}
              <span
                class="q"
                title="A run with the shift auto fits the values at each shift, which may show a larger one"
              >
                With the present values.
              </span>
            </>
          ) : (
            <span class="q">The data do not tell the shift.</span>
          )}
        </span>
        <button class="btn small" disabled={!scan.seen || next === 0} onClick={() => addShift(channel, next)}>
          Keep {plain(next, 3)} s
        </button>
        <button class="btn small" onClick={() => void scanShift(channel)}>
          Again
        </button>
      </div>
    </section>
  );
}

function drawScan(pen: Pen, width: number, height: number, scan: Scan): Read {
  const box = { left: LEFT, right: width - 12, top: 10, bottom: height - 36 };
  const [low, high] = extent(scan.rmse);
  const plot = area(pen, box, extent(scan.shifts), widened([Math.min(low, high), high], 0.08), {
    title: "shift [s]",
    yTitle: withUnit("RMSE", scan.unit),
  });
  const xs = Float64Array.from(scan.shifts, plot.x);
  const ys = Float64Array.from(scan.rmse, plot.y);
  plot.clip(() => {
    rules(pen, plot, "x", [scan.best], token("quiet"), [3, 3]);
    line(pen, xs, ys, token("model"), 1.5);
  });
  const zero = scan.shifts.findIndex((each) => Math.abs(each) < 1e-9);
  const best = scan.rmse.indexOf(low);
  dots(pen, [xs[zero]!], [ys[zero]!], token("before"), 3.5);
  dots(pen, [xs[best]!], [ys[best]!], token("model"), 3.5);
  pen.fillStyle = token("text");
  pen.fillText(`${significant(low, 3)} at ${plain(scan.shifts[best]!, 3)} s`, box.left + 8, box.bottom - 8);
  return (x) => {
    const k = nearestTo(scan.shifts, plot.xAt(x));
    const shift = scan.shifts[k];
    return shift === undefined
      ? null
      : [`RMSE ${significant(scan.rmse[k]!)} ${unitText(scan.unit)}`.trim(), `shift ${plain(shift, 3)} s`];
  };
}
