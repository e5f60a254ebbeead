// Measured and calculated over time, with the error below. Zoomed in, a strip shows its details: samples, if the page
// has room for them. Inputs and nodes of the function can be added below.

import { plain, withUnit } from "../drawing/numbers";
import { nearest } from "../drawing/strips";
import { Chart, type Pane, type Tip } from "./chart";
import { type CodedNumbers, canDecode, decodeNumbers } from "./coded-numbers";
import { make, type TipLine } from "./elements";
import { type DatasetSignals, equal, numbers, type Signal, type StripDetail, type StripFigure } from "./figures";
import { levelLayer, type Points, tracesLayer, uprightLayer } from "./layers";

const TRACES = ["measured", "before", "after", "errorBefore", "error"] as const;
type TraceName = (typeof TRACES)[number];

/** The points of a strip: samples if it is whole, else minimum and maximum of each group of samples at the same x. */
interface View {
  x: ArrayLike<number>;
  whole: boolean;
  breaks: ReadonlySet<number>;
  traces: Record<TraceName, ArrayLike<number>>;
}

const TALL = 340; // pixels
const TALL_SIGNAL = 110; // of each added signal

const decoded = new Map<CodedNumbers, Promise<Float64Array>>();

/** Decode a column once. */
function column(coded: CodedNumbers): Promise<Float64Array> {
  let values = decoded.get(coded);
  if (values === undefined) {
    values = decodeNumbers(coded);
    decoded.set(coded, values);
  }
  return values;
}

const twice = (values: Float64Array): Float64Array =>
  Float64Array.from({ length: 2 * values.length }, (_, k) => values[k >> 1]!);
const difference = (a: Float64Array, b: Float64Array): Float64Array => a.map((value, k) => value - b[k]!);

/** Return the positions at which recordings begin. */
const breaksAt = (x: ArrayLike<number>, pieces: readonly number[]): Set<number> =>
  new Set(pieces.map((piece) => nearest(x, piece)));

export function drawStrip(host: HTMLElement, f: StripFigure, signals: DatasetSignals | undefined): void {
  new Strip(host, f, signals);
}

class Strip {
  private readonly first: View;
  private details: View | null = null;
  private loading = false;
  private view: View;
  private readonly chart: Chart;
  private readonly panes: Pane[];
  private readonly added: Signal[] = [];
  private readonly points = new Map<Signal, Points>(); // of the added signals that are drawn
  private readonly chips = make("span", { class: "chips" });
  private readonly tipped: { layer: Points; name: TraceName }[];

  constructor(
    private readonly host: HTMLElement,
    private readonly f: StripFigure,
    private readonly signals: DatasetSignals | undefined,
  ) {
    const traces = Object.fromEntries(TRACES.map((name) => [name, numbers(f[name])])) as unknown as View["traces"];
    this.first = this.view = { x: f.x, whole: f.whole, breaks: breaksAt(f.x, f.pieces), traces };
    const same = equal(f.before, f.after);
    const thin = f.whole ? 1.1 : 0.9;
    const values = [
      ...(same ? [] : [this.trace("before", "model before", "before", thin, { off: true })]),
      this.trace("measured", "measured", "measured", f.whole ? 2 : 1.3),
      this.trace("after", same ? "model" : "model after", "model", thin, { opacity: f.whole && !f.time ? 0.85 : 0.9 }),
    ];
    const errors = [
      ...(same ? [] : [this.trace("errorBefore", "error before", "error-before", thin, { off: true })]),
      this.trace("error", same ? "error" : "error after", "error", thin),
    ];
    this.tipped = [...values, ...errors];
    const layers = (own: { layer: Points }[]) => own.map(({ layer }) => layer);
    this.panes = [
      { title: withUnit("value", f.unit), weight: 1.7, layers: [this.pieces(), ...layers(values)] },
      {
        title: withUnit("error", f.unit),
        weight: 1,
        zero: true,
        layers: [this.pieces(), levelLayer("axis", [0]), ...layers(errors)],
      },
    ];
    this.chart = new Chart(host, this.panes, {
      height: () => TALL + TALL_SIGNAL * this.added.length,
      title: withUnit(f.xTitle, f.xUnit),
      zoomed: (range) => this.zoomed(range !== null),
      tip: (value, _plot, _px, _py, shown) => this.tip(value, shown),
    });
    this.host.dataset.shown = this.content();
    this.offerSignals();
    this.describe();
  }

  private trace(
    name: TraceName,
    label: string,
    colour: string,
    width: number,
    options: { off?: boolean; opacity?: number } = {},
  ) {
    const source = () => ({
      x: this.view.x,
      y: this.view.traces[name],
      whole: this.view.whole,
      breaks: this.view.breaks,
    });
    return { name, layer: tracesLayer(colour, source, { name: label, width, ...options }) };
  }

  private readonly pieces = () => uprightLayer("edge", this.f.pieces, [3, 3]);

  /** Show the first view of the whole, and details of a part of it. */
  private zoomed(part: boolean): void {
    if (part && this.details === null) void this.load();
    this.show(part && this.details !== null ? this.details : this.first);
  }

  private show(view: View): void {
    this.view = view;
    this.host.dataset.shown = this.content();
    this.chart.redraw();
  }

  private content(): string {
    return this.view.whole ? "samples" : "ranges";
  }

  private async load(): Promise<void> {
    const { detail } = this.f;
    if (detail === undefined || this.loading || !canDecode) return;
    this.loading = true;
    try {
      this.details = await this.decode(detail);
    } finally {
      this.loading = false;
    }
    if (this.chart.isZoomed) this.show(this.details);
  }

  private async decode(detail: StripDetail): Promise<View> {
    const names = TRACES.filter((name) => detail.traces[name] !== undefined);
    const [stamps, ...columns] = await Promise.all([
      column(detail.x),
      ...names.map((name) => column(detail.traces[name]!)),
    ]);
    const x = detail.whole ? stamps! : twice(stamps!);
    const known = Object.fromEntries(names.map((name, k) => [name, columns[k]!])) as Record<TraceName, Float64Array>;
    if (detail.whole) {
      known.errorBefore = difference(known.before, known.measured);
      known.error = difference(known.after, known.measured);
    }
    return { x, whole: detail.whole, breaks: breaksAt(x, this.f.pieces), traces: known };
  }

  private tip(value: number, shown: (layer: Points) => boolean): Tip | null {
    const { x, whole, traces } = this.view;
    if (!x.length) return null;
    const k = nearest(x, value);
    const visible = this.tipped.filter(({ layer }) => shown(layer));
    const [xTitle, xUnit] = [this.f.xTitle, this.f.xUnit];
    if (whole) {
      const lines = visible.map<TipLine>(({ name, layer }) => [
        `${layer.name} ${plain(traces[name][k]!, 5)}`,
        layer.colour,
      ]);
      return { x: x[k], lines: [[`${xTitle} ${plain(x[k]!, 7)} ${xUnit}`], ...lines, ...this.furtherLines(x[k]!)] };
    }
    const first = k - (k % 2);
    const ends = visible.map<TipLine>(({ name, layer }) => [
      `${layer.name} ${plain(traces[name][first]!, 4)} to ${plain(traces[name][first + 1]!, 4)}`,
      layer.colour,
    ]);
    return { x: x[first], lines: [[`from ${plain(x[first]!, 7)} ${xUnit}`], ...ends, ...this.furtherLines(x[first]!)] };
  }

  /** Say what the added signals are at a place. */
  private furtherLines(at: number): TipLine[] {
    return [...this.points].map(([{ name }, { x, y }]) => [`${name} ${plain(y[nearest(x, at)]!, 5)}`, "model"]);
  }

  /** Offer the inputs and nodes of the dataset, each in a strip of its own below. */
  private offerSignals(): void {
    if (this.signals === undefined || !canDecode) return;
    const choice = make(
      "select",
      { "aria-label": "Add a signal below" },
      make("option", { value: "" }, "add a signal…"),
    );
    for (const [kind, label] of [
      ["input", "inputs"],
      ["node", "nodes"],
    ] as const) {
      const own = this.signals.signals.filter((signal) => signal.kind === kind);
      const options = own.map((signal) =>
        make("option", { value: String(this.signals!.signals.indexOf(signal)) }, withUnit(signal.name, signal.unit)),
      );
      if (own.length) choice.append(make("optgroup", { label }, ...options));
    }
    if (this.signals.leftOut)
      choice.append(make("option", { disabled: "" }, `${this.signals.leftOut} more have no room`));
    choice.addEventListener("change", () => {
      const signal = this.signals!.signals[Number(choice.value)];
      choice.value = "";
      if (signal !== undefined && !this.added.includes(signal)) void this.add(signal);
    });
    this.host.append(make("div", { class: "further" }, choice, this.chips));
  }

  private async add(signal: Signal): Promise<void> {
    this.added.push(signal);
    const { whole } = this.signals!;
    const [stamps, y] = await Promise.all([column(this.signals!.x), column(signal.values)]);
    if (!this.added.includes(signal)) return;
    const x = whole ? stamps : twice(stamps);
    const breaks = breaksAt(x, this.f.pieces);
    const layer = tracesLayer("model", () => ({ x, y, whole, breaks }), { width: 1.1 });
    const pane: Pane = { title: withUnit(signal.name, signal.unit), weight: 1, layers: [this.pieces(), layer] };
    this.panes.push(pane);
    this.points.set(signal, layer);
    const remove = make("button", { type: "button", "aria-label": `Remove ${signal.name}` }, "×");
    const chip = make("span", { class: "chip" }, signal.name, remove);
    remove.addEventListener("click", () => {
      this.added.splice(this.added.indexOf(signal), 1);
      this.panes.splice(this.panes.indexOf(pane), 1);
      this.points.delete(signal);
      chip.remove();
      this.resize();
    });
    this.chips.append(chip);
    this.resize();
  }

  private resize(): void {
    // the first two panes keep their height
    const share = TALL / 2.7;
    for (const pane of this.panes.slice(2)) pane.weight = TALL_SIGNAL / share;
    this.chart.redraw();
    this.host.dataset.signals = this.added.map(({ name }) => name).join(",");
  }

  /** Say what a point stands for where the page has no room for all samples. */
  private describe(): void {
    const size = this.f.detail?.size ?? 1;
    const refined = this.f.detail !== undefined && canDecode;
    if (this.f.whole || (refined && size === 1)) return;
    const note = !refined
      ? "Each point is the range of several samples."
      : `Zoomed in, each point is the range of ${size} samples.`;
    this.host.append(make("p", { class: "note" }, note));
  }
}
