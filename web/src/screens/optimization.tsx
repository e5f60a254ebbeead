// The optimization: what is fitted and how, the check before the run, and its progress.

import { computed, effect, signal } from "@preact/signals";
import { newest } from "../connection";
import { type Area, area, line, type Pen, ticks } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { drawGrid } from "../drawing/grid";
import { rules } from "../drawing/marks";
import { count, MISSING, significant, unitText } from "../drawing/numbers";
import { drawCurves } from "../drawing/slices";
import { Footer, Key } from "../frame";
import type { Read } from "../hover-tip";
import { Icon } from "../icons";
import { FindingLine } from "../instruments/finding";
import { Picture } from "../instruments/picture";
import type { CoarseTable, StartRow, StepRow } from "../replies";
import { run, view } from "../runs";
import { scoped } from "../scope";
import { blocking, isRunning, jobTitle, open, request, screen, settled, state } from "../store";
import { OutcomeBody, OutcomeHead } from "./optimization/outcome";
import { RunOptions } from "./optimization/resume";
import { OptimizationSettings } from "./optimization/settings";

interface Progress {
  starts: StartRow[];
  tables: CoarseTable[];
  steps: StepRow[];
  lines: Record<string, Float32Array>;
}

const progress = scoped<Progress>({ starts: [], tables: [], steps: [], lines: {} });
const quantity = signal<"rmse" | "cost">("rmse");

const load = newest(async (_: number) => {
  const reply = await request("progress");
  if (reply !== null)
    progress.value = {
      starts: reply.head.starts,
      tables: reply.head.tables,
      steps: reply.head.steps,
      lines: reply.arrays,
    };
});

const iterations = computed(() => state.value.job.iterations);

effect(() => {
  const { revision, project } = settled.value;
  if (screen.value === "optimization" && project !== null) load(iterations.value + revision);
});

export function Optimization() {
  const { job } = state.value;
  const running = isRunning(job);
  return (
    <>
      <main class="optimization">
        <Settings />
        <section class="pane prog">
          <div class="pl">
            <b class="acc" id="progress">
              {running
                ? job.validates
                  ? "Cross-validation"
                  : `Run ${job.run + 1}`
                : job.state === "idle"
                  ? "No run yet"
                  : jobTitle(state.value).replace(/[.:]$/, "")}
            </b>
            <span class="cut">{job.message}</span>
            <RunOptions />
            <span class="right q">
              {job.iterations ? `${count(job.iterations)} steps, ${job.seconds.toFixed(2)} s` : ""}
            </span>
          </div>
        </section>
        <section class="pane cost">
          <div class="head">
            <h2>{quantity.value === "rmse" ? "RMSE of the training data" : "Cost"}</h2>
            <span class="sub">against iteration</span>
            <span class="right">
              <span class="seg tight">
                <button
                  aria-pressed={quantity.value === "rmse"}
                  onClick={() => {
                    quantity.value = "rmse";
                  }}
                >
                  RMSE
                </button>
                <button
                  aria-pressed={quantity.value === "cost"}
                  onClick={() => {
                    quantity.value = "cost";
                  }}
                >
                  cost
                </button>
              </span>
            </span>
          </div>
          {progress.value.starts.length ? (
            <Picture label="Course of the search" kind="body" draw={drawCourse} of={[progress.value, quantity.value]} />
          ) : (
            <p class="pad q">
              The course of the search appears here.{" "}
              <button class="btn small" disabled={blocking.value !== null} title={blocking.value?.text} onClick={run}>
                Run
              </button>
            </p>
          )}
        </section>
        <Starts />
        <section class="pane mv">
          <OutcomeHead sub={running ? "best so far, twice a second" : "now"} steps={progress.value.steps} />
          {view.value === "tables" ? (
            <div class="mmg">
              {progress.value.tables.slice(0, 4).map((each) => (
                <SmallTable own={each} />
              ))}
            </div>
          ) : (
            <OutcomeBody steps={progress.value.steps} />
          )}
        </section>
      </main>
      <Footer>
        <Key keys={["F5"]} text="run" />
        <Key keys={["Shift", "F5"]} text="stop and keep the best" />
      </Footer>
    </>
  );
}

function Settings() {
  const { parameters, freeValues, findings, datasets } = state.value;
  const remarks = findings.filter((f) => f.severity !== "remark");
  const samples = (use: string) => datasets.filter((d) => d.use === use).reduce((sum, d) => sum + d.samples, 0);
  return (
    <section class="pane cfg">
      <div class="head">
        <h2>Free parameters</h2>
        <span class="sub">{count(freeValues)} values</span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>
              <span class="unseen">fitted</span>
            </th>
            <th>parameter</th>
            <th class="num">values</th>
            <th>unit</th>
            <th class="num">without data</th>
          </tr>
        </thead>
        <tbody>
          {parameters.map((p) => (
            <tr
              data-parameter={p.name}
              onClick={() => {
                open(p.name);
                screen.value = "parameters";
              }}
            >
              <td>
                <span class={`tick ${p.free ? "on" : ""}`}>{p.free && <Icon name="done" />}</span>
              </td>
              <td>
                <b>{p.name}</b>
              </td>
              <td class="num">{p.shape.reduce((a, b) => a * b, 1)}</td>
              <td class="q">{unitText(p.unit)}</td>
              <td class="num q">{p.withoutData || MISSING}</td>
            </tr>
          ))}
        </tbody>
      </table>
      <OptimizationSettings />
      <div class="head mid">
        <h2>Check before the run</h2>
        <span class="right">
          {remarks.length > 0 && (
            <span class="tag w">
              {remarks.length} message{remarks.length > 1 ? "s" : ""}
            </span>
          )}
        </span>
      </div>
      <div class="cks">
        {blocking.value === null && (
          <div class="ck g">
            <Icon name="done" />
            <span class="grow">
              {count(freeValues)} values of {parameters.filter((p) => p.free).length} parameters;{" "}
              {count(samples("training"))} training and {count(samples("test"))} test samples
            </span>
          </div>
        )}
        {findings.map((f) => (
          <FindingLine key={f.text} own={f} />
        ))}
      </div>
    </section>
  );
}

function Starts() {
  const folds = state.value.job.validates;
  const best = Math.min(...progress.value.starts.map((row) => row.cost ?? Infinity));
  return (
    <section class="pane sts">
      <div class="head">
        <h2>{folds ? "Folds" : "Starts"}</h2>
        <span class="sub">
          {folds
            ? "each part of the data is held out once, and scored with the values of the others"
            : "the first from the present values, the others spread around it"}
        </span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th class="num">{folds ? "fold" : "start"}</th>
            <th>state</th>
            <th>stage</th>
            <th class="num">iterations</th>
            <th class="num">cost before</th>
            <th class="num">cost</th>
            <th class="num">RMSE</th>
            <th class="num">time</th>
            <th>
              <span class="unseen">best</span>
            </th>
          </tr>
        </thead>
        <tbody>
          {progress.value.starts.map((row) => (
            <tr class={row.cost === best ? "on" : ""}>
              <td class="num">{row.start}</td>
              <td>
                <span class={`tag ${row.state === "converged" ? "g" : row.state === "running" ? "t" : "w"}`}>
                  {row.state}
                </span>
              </td>
              <td class="q">{row.state === "running" ? row.stage : ""}</td>
              <td class="num">{row.iterations}</td>
              <td class="num q">{cost(row.before)}</td>
              <td class="num ink">{cost(row.cost)}</td>
              <td class="num ink">{row.rmse === null ? MISSING : significant(row.rmse, 5)}</td>
              <td class="num">{row.seconds.toFixed(2)} s</td>
              <td>{row.cost === best && progress.value.starts.length > 1 ? <b class="good">best</b> : ""}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}

const cost = (value: number | null): string => (value === null ? MISSING : significant(value, 5));

/** Where the stages of the search begin, with their names; of one start alone, those of several lie over each other. */
function drawStages(pen: Pen, plot: Area, width: number): void {
  const [only, ...others] = progress.value.starts;
  if (only === undefined || others.length > 0 || only.stages.length < 2) return;
  pen.textAlign = "left";
  pen.textBaseline = "top";
  let free = plot.box.left; // where the last name ends
  for (const { name, begin } of only.stages) {
    const at = Math.round(plot.x(begin + 0.5)) + 0.5;
    rules(pen, plot, "x", [plot.xAt(at)], token("edge"), [3, 3]);
    const wide = pen.measureText(name).width;
    if (at + 4 < free || at + 4 + wide > width - 8) continue;
    pen.fillStyle = token("quiet");
    pen.fillText(name, at + 4, plot.box.top + 3);
    free = at + wide + 12;
  }
}

/** Logarithmic: an iteration at the start changes more than a thousand at the end. */
function drawCourse(pen: Pen, width: number, height: number): Read | undefined {
  const lines = progress.value.starts.map(
    (row) => progress.value.lines[`${quantity.value} ${row.start}`] ?? new Float32Array(),
  );
  const [low, high] = [
    Math.min(...lines.flatMap((l) => [...l].filter((v) => v > 0))),
    Math.max(...lines.flatMap((l) => [...l].filter(Number.isFinite))),
  ];
  if (!(high > 0 && low > 0)) return undefined;
  const box = { left: 56, right: width - 60, top: 10, bottom: height - 36 };
  const edge = (high / low) ** 0.03 * 1.002;
  const most = Math.max(2, ...lines.map((l) => l.length));
  const plot = area(pen, box, [0, most], [low / edge, high * edge], {
    title: "iteration",
    xTicks: ticks(0, most, 8),
    scale: "log",
  });
  drawStages(pen, plot, width);
  progress.value.starts.forEach((row, k) => {
    const values = lines[k]!;
    const colour = token(row.state === "running" ? "model" : progress.value.starts.length > 1 ? "before" : "model");
    const xs = Float64Array.from(values, (_, i) => plot.x(i + 1));
    line(pen, xs, Float64Array.from(values, plot.y), colour, 1.4);
    if (!values.length) return;
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(xs[xs.length - 1]!, plot.y(values[values.length - 1]!), 3.5, 0, 2 * Math.PI);
    pen.fill();
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(
      progress.value.starts.length > 1 ? `${state.value.job.validates ? "fold" : "start"} ${row.start}` : "",
      xs[xs.length - 1]! + 6,
      plot.y(values[values.length - 1]!) - 3,
    );
  });
  return (x) => {
    const iteration = Math.round(plot.xAt(x));
    const known = lines.map((values, k) => [progress.value.starts[k]!.start, values[iteration - 1]] as const);
    const told = known.filter((each) => each[1] !== undefined);
    if (told.length === 0) return null;
    const name = state.value.job.validates ? "fold" : "start";
    return [
      `iteration ${iteration}`,
      ...told
        .slice(0, 8)
        .map(([start, value]) => `${lines.length > 1 ? `${name} ${start}` : quantityName()} ${significant(value!)}`),
    ];
  };
}

const quantityName = (): string => (quantity.value === "rmse" ? "RMSE" : "cost");

function SmallTable({ own }: { own: CoarseTable }) {
  const draw = (pen: Pen, width: number, height: number): Read | undefined => {
    const unit = unitText(own.unit);
    if (own.ends.length === 2) {
      const at = drawGrid(pen, width, height, { x: own.ends[0]!, y: own.ends[1]!, values: own.values });
      return (x, y) => {
        const cell = at(x, y);
        return cell === null ? null : [`${significant(own.values[cell[0]]![cell[1]]!)} ${unit}`];
      };
    }
    if (own.ends.length !== 1) return undefined;
    const [start, now] = [own.start.flat(), own.values.flat()];
    const { box } = drawCurves(pen, width, height, own.ends[0]!, start, now);
    return (x) => {
      const k = Math.round(((x - box.left) / (box.right - box.left)) * (now.length - 1));
      return now[k] === undefined ? null : [`${significant(now[k])} ${unit}`, `start ${significant(start[k]!)}`];
    };
  };
  return (
    <div class="mm">
      <div class="mt">
        <b>{own.name}</b>
        <span class="q">{unitText(own.unit)}</span>
      </div>
      <Picture label={own.name} draw={draw} of={[own]} />
    </div>
  );
}
