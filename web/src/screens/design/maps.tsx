// Deviations of a table now and as predicted, on one logarithmic scale, with what is recorded and what is to be driven.

import { deviationText, map, outcome, type Shown, segment, shown, table } from "../../design";
import { area, type Box, extent, line, logTicks, type Pen, widened } from "../../drawing/canvas";
import { css, deviation, height as heightColour, token } from "../../drawing/colours";
import { dots, hatch, ring } from "../../drawing/marks";
import { plain, significant, unitText, withUnit } from "../../drawing/numbers";
import { lastUpTo } from "../../drawing/strips";
import { Segment } from "../../fields";
import type { Read } from "../../hover-tip";
import { Picture } from "../../instruments/picture";
import { placeText } from "../../instruments/pictures";
import type { DesignMap, Questions } from "../../replies";
import { blocking, state } from "../../store";

type Arrays = Questions["design-map"]["arrays"];
type Side = "now" | "after";

export function MapsPane() {
  const [own, reply] = [table.value, map.value];
  return (
    <section class="maps2" aria-label="Deviations">
      <div class="head">
        <h2>{own?.name ?? "Measure next"}</h2>
        {outcome.value?.old ? (
          <span class="sub warn" id="design-old">
            older than the values
          </span>
        ) : (
          <span class="sub">{own === null ? "" : "standard deviation of each value, one scale for both"}</span>
        )}
        {own !== null && (
          <span class="right">
            <span class="key">
              <i class="dot" style={{ background: "var(--quiet)", width: "4px", height: "4px" }} />
              recorded
            </span>
            <span class="key">
              <i class="box hatched" />
              no data
            </span>
            <span class="key">
              <i style={{ color: "var(--lit)" }} />
              {outcome.value!.segments.length ? "to drive" : "to measure"}
            </span>
            <Segment
              label="Show"
              options={["deviation", "value", "gain"]}
              chosen={shown.value}
              choose={(option) => {
                shown.value = option as Shown;
              }}
            />
          </span>
        )}
      </div>
      {own === null || reply === null ? <Empty /> : <Pictures head={reply.head} arrays={reply.arrays} />}
    </section>
  );
}

function Empty() {
  const { state: own, text } = state.value.design;
  if (own === "failed")
    return (
      <p class="note bad" id="design-failed">
        <span class="grow">{text}</span>
      </p>
    );
  if (outcome.value?.stopped.length)
    return <p class="pad q">Deviations are drawn for a design that has gone on to its end.</p>;
  if (outcome.value !== null) return <p class="pad q">A design without a fit: it has no deviations to show.</p>;
  return (
    <div class="pad" id="nothing-proposed">
      <p>
        Proposes where to measure so that the values become known: minutes of driving, steady points, or the recordings
        that add nothing.
      </p>
      {state.value.runs.length === 0 && state.value.parameters.length > 0 && (
        <p class="q">The function is fitted first, without a change of the values in the project.</p>
      )}
      {blocking.value !== null && (
        <p class="q">The project cannot be evaluated yet; points that fill ranges need no data.</p>
      )}
    </div>
  );
}

function Pictures({ head, arrays }: { head: DesignMap; arrays: Arrays }) {
  const of = [head, shown.value, segment.value];
  if (head.axes.length !== 2 || head.axes.some((axis) => axis.input === ""))
    return (
      <Picture
        kind="body"
        label="Deviations of the values, now and as predicted"
        of={of}
        draw={(pen, width, height) => drawCurve(pen, width, height, head, arrays)}
      />
    );
  return (
    <>
      {(["now", "after"] as const).map((side) => (
        <Picture
          kind="mpx"
          label={side === "now" ? "Deviations now" : "Deviations as predicted"}
          of={of}
          draw={(pen, width, height) => drawMap(pen, width, height, head, arrays, side)}
        />
      ))}
      <Picture kind="cb" label="Scale" of={of} draw={(pen, width) => drawScale(pen, width, head, arrays)} />
    </>
  );
}

const ramp = (share: number): string => css(deviation(share));

/** The ends of the logarithmic scale of both maps: those of the finite deviations. */
function ends({ before, after }: Arrays): [number, number] {
  const known = [...before, ...after].filter((value) => value > 0 && Number.isFinite(value));
  const [low, high] = known.length ? extent(known) : [0.1, 1];
  return [Math.max(low, high * 1e-3), high > low ? high : low * 1.01];
}

/** The share of a value on the scale; 1 for what is undetermined. */
const shareOf = (value: number, [low, high]: [number, number]): number =>
  value === Infinity ? 1 : value > 0 ? Math.log(value / low) / Math.log(high / low) : 0;

/** The edges of the cells around breakpoints, half way to their neighbours. */
function edgesOf(points: readonly number[]): number[] {
  const inner = points.slice(1).map((point, k) => (point + points[k]!) / 2);
  const [first, last] = [points[0]!, points.at(-1)!];
  const begin = inner.length ? 2 * first - inner[0]! : first - 0.5;
  const end = inner.length ? 2 * last - inner.at(-1)! : last + 0.5;
  return [begin, ...inner, end];
}

function drawMap(pen: Pen, width: number, height: number, head: DesignMap, own: Arrays, side: Side): Read {
  const box = { left: 60, right: width - 14, top: 28, bottom: height - 36 };
  const [xs, ys] = head.axes.map((axis) => axis.points) as [number[], number[]];
  const [xEdges, yEdges] = [edgesOf(xs), edgesOf(ys)];
  const plot = area(pen, box, [xEdges[0]!, xEdges.at(-1)!], [yEdges[0]!, yEdges.at(-1)!], {
    xTicks: thinned(xs, 6),
    yTicks: thinned(ys, 8),
    title: withUnit(head.axes[0]!.input, head.axes[0]!.unit),
    yTitle: withUnit(head.axes[1]!.input, head.axes[1]!.unit),
  });
  const paint = painter(own, side);
  plot.clip(() => {
    xs.forEach((_, i) =>
      ys.forEach((__, j) => {
        const k = i * ys.length + j;
        const [left, right] = [plot.x(xEdges[i]!), plot.x(xEdges[i + 1]!)];
        const [top, bottom] = [plot.y(yEdges[j + 1]!), plot.y(yEdges[j]!)];
        pen.beginPath();
        pen.rect(left, top, right - left + 0.5, bottom - top + 0.5);
        pen.fillStyle = paint(k);
        pen.fill();
        if (side === "now" && head.empty[k]) hatch(pen);
      }),
    );
    if (side === "now") {
      pen.globalAlpha = 0.5;
      pen.fillStyle = token("quiet");
      for (let k = 0; k < own.x.length; k++) pen.fillRect(plot.x(own.x[k]!) - 1, plot.y(own.y[k]!) - 1, 1.8, 1.8);
      pen.globalAlpha = 1;
    }
    drawWays(pen, plot, head, own);
  });
  drawTitle(pen, box, head, own, side);
  const within = (edges: number[], value: number): number =>
    value >= edges[0]! && value <= edges.at(-1)! ? Math.min(edges.length - 2, lastUpTo(edges, value)) : -1;
  return (x, y) => {
    const [i, j] = [within(xEdges, plot.xAt(x)), within(yEdges, plot.yAt(y))];
    if (i < 0 || j < 0) return null;
    const k = i * ys.length + j;
    return [
      `deviation ${deviationText(own.before[k]!)} now, ${deviationText(own.after[k]!)} predicted`,
      `value ${significant(own.values[k]!)} ${unitText(head.unit)}`,
      placeText(head.axes, [i, j]),
    ];
  };
}

/** The colour of each cell: a deviation, a value, or how much smaller a deviation becomes. */
function painter(own: Arrays, side: Side): (k: number) => string {
  if (shown.value === "value" && side === "now") {
    const [low, high] = extent(own.values);
    return (k) => css(heightColour(high > low ? (own.values[k]! - low) / (high - low) : 0.5), 0.8);
  }
  if (shown.value === "gain" && side === "after")
    // undetermined before and after is no gain
    return (k) => ramp(own.after[k] === Infinity ? 0 : Math.log2(own.before[k]! / own.after[k]!) / 4);
  const scale = ends(own);
  const values = side === "now" ? own.before : own.after;
  return (k) => ramp(shareOf(values[k]!, scale));
}

function drawTitle(pen: Pen, box: Box, head: DesignMap, own: Arrays, side: Side): void {
  const row = table.value;
  const at = side === "now" ? 0 : 1;
  const stage = side === "now" ? "now" : `after ${whatIsDone()}, predicted`;
  const title =
    shown.value === "value" && side === "now"
      ? "values of the fit"
      : shown.value === "gain" && side === "after"
        ? "gain: deviation now over that predicted, to 16"
        : stage;
  pen.font = `600 12px ${token("font")}`;
  pen.fillStyle = token("ink");
  pen.fillText(title, box.left, 18);
  pen.font = `11px ${token("font")}`;
  if (row === null || (shown.value !== "deviation" && title !== stage)) return;
  const open = [...(side === "now" ? own.before : own.after)].filter((value) => value === Infinity).length;
  pen.fillStyle = token("quiet");
  pen.textAlign = "right";
  const facts = `median ${deviationText(row.median[at])}, greatest ${deviationText(row.greatest[at])} ${unitText(head.unit)}`;
  const full = open ? `${facts}, ${open} open` : facts;
  if (pen.measureText(full).width + pen.measureText(title).width * 1.2 < box.right - box.left)
    pen.fillText(full, box.right, 18);
  pen.textAlign = "left";
}

function whatIsDone(): string {
  const own = outcome.value!;
  if (own.segments.length) return `${own.segments.length} segments`;
  return own.points.length ? `${own.points.length} points` : `without ${own.drop.length} recordings`;
}

/** Draw segments as arrows with their number, or points as discs; the chosen one in amber. */
function drawWays(
  pen: Pen,
  plot: { x: (value: number) => number; y: (value: number) => number },
  head: DesignMap,
  own: Arrays,
): void {
  const [xs, ys] = [Array.from(own.wayX, plot.x), Array.from(own.wayY, plot.y)];
  if (!head.isDrive) {
    const every = xs.map((_, k) => k).filter((k) => k !== segment.value);
    for (const k of [...every, segment.value])
      if (k < xs.length)
        ring(pen, [xs[k]!, ys[k]!], 4.2, token(k === segment.value ? "lit" : "ink"), token("paper"), 1.2);
    return;
  }
  const numbers = head.ways
    .map((_, k) => k)
    .toSorted((a, b) => Number(a === segment.value) - Number(b === segment.value));
  for (const k of numbers) {
    const [first, end] = [head.ways[k]!, head.ways[k + 1] ?? xs.length];
    const [wx, wy] = [xs.slice(first, end), ys.slice(first, end)];
    if (wx.length === 0) continue;
    const chosen = k === segment.value;
    pen.globalAlpha = chosen ? 1 : 0.28; // a drive passes many places: only one can be followed
    if (chosen) line(pen, wx, wy, token("paper"), 4);
    line(pen, wx, wy, token(chosen ? "lit" : "ink"), chosen ? 2 : 1);
    pen.globalAlpha = 1;
    badge(pen, wx[0]!, wy[0]!, String(k + 1), chosen);
  }
}

function badge(pen: Pen, x: number, y: number, text: string, chosen: boolean): void {
  ring(pen, [x, y], 8.5, token(chosen ? "lit" : "ink"), token("paper"), 1.5);
  pen.fillStyle = chosen ? "#16191d" : token("paper");
  pen.font = `600 10.5px ${token("font")}`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, x, y + 0.5);
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  pen.font = `11px ${token("font")}`;
}

function drawScale(pen: Pen, width: number, head: DesignMap, own: Arrays): void {
  const wide = Math.min(420, width - 180);
  const left = Math.round((width - wide) / 2);
  const scale = ends(own);
  for (let k = 0; k < wide; k++) {
    pen.fillStyle = ramp(k / wide);
    pen.fillRect(left + k, 8, 1.5, 7);
  }
  pen.fillStyle = token("quiet");
  pen.textBaseline = "middle";
  pen.textAlign = "center";
  const ticks = logTicks(...scale);
  for (const value of ticks.length > 2 ? ticks : scale)
    pen.fillText(plain(value, 3), left + shareOf(value, scale) * wide, 25);
  pen.textAlign = "left";
  pen.fillText(`${unitText(head.unit)}, logarithmic`.replace(/^, /, ""), left + wide + 16, 12);
  pen.textBaseline = "alphabetic";
}

/** At most so many of the points, evenly. */
function thinned(points: number[], most: number): number[] {
  const every = Math.ceil(points.length / most);
  return points.filter((_, k) => k % every === 0).map((value) => Number(value.toPrecision(4)));
}

/** Draw the deviations of a curve over its axis; of other tables, one value after the other. */
function drawCurve(pen: Pen, width: number, height: number, head: DesignMap, own: Arrays): void {
  const box = { left: 60, right: width - 16, top: 28, bottom: height - 40 };
  const isCurve = head.axes.length === 1;
  const points = isCurve ? head.axes[0]!.points : Array.from(own.values, (_, k) => k + 1);
  const scale = ends(own);
  const plot = area(pen, box, widened(extent(points), 0.02), [scale[0] / 1.3, scale[1] * 1.3], {
    title: isCurve ? withUnit(head.axes[0]!.input, head.axes[0]!.unit) : "value",
    scale: "log",
  });
  const xs = points.map(plot.x);
  const shownAt = (values: ArrayLike<number>) =>
    Array.from(values, (value) => plot.y(value === Infinity ? scale[1] * 1.3 : Math.max(value, scale[0])));
  plot.clip(() => {
    line(pen, xs, shownAt(own.before), token("before"), 1.5);
    line(pen, xs, shownAt(own.after), token("model"), 1.6);
  });
  dots(pen, xs, shownAt(own.before), token("before"), 2.6);
  dots(pen, xs, shownAt(own.after), token("model"), 3);
  pen.fillStyle = token("text");
  pen.fillText(withUnit("standard deviation: grey now, blue as predicted", head.unit), box.left, 18);
}
