// The chosen node and the error around the cursor, now and at the start.

import { computed, effect } from "@preact/signals";
import { newest } from "../../connection";
import { area, extent, line, type Pen, widened } from "../../drawing/canvas";
import { token } from "../../drawing/colours";
import { plain, significant, unitText } from "../../drawing/numbers";
import { lastUpTo } from "../../drawing/strips";
import type { Read } from "../../hover-tip";
import { split } from "../../instruments/error-split";
import { Picture } from "../../instruments/picture";
import { criterion, cursor, datasetNumber } from "../../plots";
import type { SignalName } from "../../replies";
import { scoped } from "../../scope";
import { request, revision, screen, settled } from "../../store";
import { chosen, simulink } from "./source";

const AROUND = 80; // samples on each side of the cursor

interface Strip {
  begin: number;
  x: Float32Array;
  start: Float32Array;
  now: Float32Array;
  error: Float32Array;
  measured: Float32Array | undefined; // if the node is that of the criterion
}
const strip = scoped<Strip | null>(null);

const load = newest(async ([dataset, begin, end, node, criterion]: [number, number, number, string, number]) => {
  const signals: SignalName[] = [
    { kind: "start", name: node },
    { kind: "node", name: node },
    { kind: "error", name: String(criterion) },
  ];
  if (settled.peek().criteria[criterion]?.node === node) signals.push({ kind: "target", name: String(criterion) });
  const reply = await request("strip", { dataset, begin, end, pixels: 460, signals });
  if (reply !== null)
    strip.value = {
      begin: reply.head.begin,
      x: reply.arrays.x,
      start: reply.arrays["0"]!,
      now: reply.arrays["1"]!,
      error: reply.arrays["2"]!,
      measured: reply.arrays["3"],
    };
});

/** The node that is drawn: the chosen one, else that of the criterion. */
export const drawnNode = computed(() => {
  const { nodes } = settled.value;
  return nodes.some((node) => node.name === chosen.value) ? chosen.value : (criterion.value?.node ?? "");
});

const place = computed(() => split.value?.position ?? null);

effect(() => {
  void revision.value;
  const data = settled.value.datasets[datasetNumber.value];
  if (
    screen.value !== "function" ||
    simulink.value ||
    data === undefined ||
    place.value === null ||
    !settled.value.nodes.some((node) => node.name === drawnNode.value)
  )
    return;
  const reach = (AROUND * (data.end - data.begin)) / Math.max(1, data.samples - 1);
  load([
    datasetNumber.value,
    Math.max(data.begin, place.value - reach),
    Math.min(data.end, place.value + reach),
    drawnNode.value,
    split.value!.criterion,
  ]);
});

export function NodeStrip() {
  const unit = settled.value.nodes.find((node) => node.name === drawnNode.value)?.unit ?? "";
  return (
    <>
      <div class="head mid">
        <h2>{drawnNode.value || "Node"}</h2>
        <span class="sub">{unitText(unit) && `[${unit}] `}around the cursor; a click moves it</span>
        <span class="right">
          {strip.value?.measured && (
            <span class="key">
              <i style={{ borderColor: "var(--ink)" }} />
              measured
            </span>
          )}
          <span class="key">
            <i style={{ borderColor: "var(--model)" }} />
            now
          </span>
          <span class="key">
            <i style={{ borderColor: "var(--before)" }} />
            start
          </span>
          <span class="key">
            <i style={{ borderColor: "var(--error)" }} />
            error
          </span>
        </span>
      </div>
      <div class="strip-box" onClick={pick}>
        <Picture
          label={`${drawnNode.value} and the error around the cursor`}
          kind="node-strip"
          draw={draw}
          of={[strip.value, split.value]}
        />
      </div>
    </>
  );
}

const LEFT = 44;
const RIGHT = 12;

function pick(event: MouseEvent): void {
  const data = strip.value;
  const box = (event.currentTarget as HTMLElement).getBoundingClientRect();
  if (data === null || data.x.length === 0) return;
  const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
  const last = data.x.at(-1)!;
  cursor.value = data.begin + data.x[0]! + Math.max(0, Math.min(1, share)) * (last - data.x[0]!);
}

function draw(pen: Pen, width: number, height: number): Read | undefined {
  const data = strip.value;
  if (data === null || data.x.length === 0) return undefined;
  const xs = Float64Array.from(data.x, (x) => x + data.begin);
  const middle = Math.round(height * 0.58);
  const upper = area(
    pen,
    { left: LEFT, right: width - RIGHT, top: 8, bottom: middle - 8 },
    extent(xs),
    widened(extent(data.start, data.now, data.measured ?? []), 0.08),
    { unlabelled: true },
  );
  upper.clip(() => {
    const at = xs.map(upper.x);
    if (data.measured) line(pen, at, Float64Array.from(data.measured, upper.y), token("ink"), 1.25);
    line(pen, at, Float64Array.from(data.start, upper.y), token("before"), 1.25);
    line(pen, at, Float64Array.from(data.now, upper.y), token("model"), 1.5);
    mark(pen, upper.x, 8, middle - 8);
  });
  const known = data.error.filter(Number.isFinite);
  const lower = area(
    pen,
    { left: LEFT, right: width - RIGHT, top: middle + 2, bottom: height - 32 },
    extent(xs),
    widened(extent(known, [0]), 0.08),
    { title: settled.value.datasets[datasetNumber.value]?.timed ? "time [s]" : "point" },
  );
  lower.clip(() => {
    line(pen, xs.map(lower.x), Float64Array.from(data.error, lower.y), token("error"), 1.25);
    mark(pen, lower.x, middle + 2, height - 32);
  });
  return (x) => {
    const k = lastUpTo(xs, upper.xAt(x));
    const { timed } = settled.value.datasets[datasetNumber.value] ?? {};
    return [
      `now ${significant(data.now[k]!)}`,
      ...(data.measured ? [`measured ${significant(data.measured[k]!)}`] : []),
      `start ${significant(data.start[k]!)}`,
      `error ${significant(data.error[k]!)}`,
      timed ? `at ${plain(xs[k]!, 7)} s` : `point ${plain(xs[k]!, 7)}`,
    ];
  };
}

function mark(pen: Pen, x: (value: number) => number, top: number, bottom: number): void {
  const own = split.value;
  if (own === null) return;
  pen.strokeStyle = token("ink");
  pen.setLineDash([3, 3]);
  pen.beginPath();
  pen.moveTo(x(own.position), top);
  pen.lineTo(x(own.position), bottom);
  pen.stroke();
  pen.setLineDash([]);
}
