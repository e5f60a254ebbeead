// A chart: strips over a common x axis, zoom by dragging or by keys, a crosshair, a legend that hides and shows.

import { type Area, canvasIn, extent, type Pen, type Range, widened } from "../drawing/canvas";
import { drawStrips, within } from "../drawing/strips";
import { hideTip, make, showTip, type TipLine, toggle } from "./elements";
import type { Layer } from "./layers";

export interface Pane {
  title: string;
  weight?: number;
  scale?: "linear" | "log" | "counts";
  range?: Range;
  zero?: boolean;
  layers: Layer[];
}

/** What the tooltip says at a place; `x` puts the crosshair there. */
export interface Tip {
  x?: number;
  lines: TipLine[];
}

export interface ChartOptions {
  height: (width: number) => number;
  left?: number;
  title: string; // of the x axis
  range?: Range; // of x
  margin?: number; // share of x on both sides
  whole?: boolean; // x counts
  fixed?: boolean; // no zoom
  zoomed?: (range: Range | null) => void; // after the range of x has changed; null is the whole
  legend?: boolean;
  tip: (value: number, plot: Area, px: number, py: number, shown: (layer: Layer) => boolean) => Tip | null;
}

const HISTORY = 100; // ranges to which Backspace returns

export class Chart {
  private readonly hidden = new Set<string>();
  private readonly box = make("div", { class: "canvas" });
  private readonly mark = make("div", { class: "mark" });
  private readonly cross = make("div", { class: "cross" });
  /** Draw again, at most once a frame. */
  readonly redraw: () => void;
  private zoom: Range | null = null;
  private readonly earlier: (Range | null)[] = [];
  private plots: Area[] = [];

  constructor(
    host: HTMLElement,
    private readonly panes: Pane[],
    private readonly options: ChartOptions,
  ) {
    const layers = panes.flatMap((pane) => pane.layers);
    for (const layer of layers) if (layer.off) this.hidden.add(layer.name!);
    if (options.legend !== false) this.addLegend(host, layers);
    host.append(this.box);
    const { canvas, redraw } = canvasIn(
      this.box,
      (pen, width, height) => this.draw(pen, width, height),
      options.height,
    );
    this.redraw = redraw;
    this.box.append(this.mark, this.cross);
    this.listen(canvas);
  }

  /** Whether less than the whole is shown. */
  get isZoomed(): boolean {
    return this.zoom !== null;
  }

  private readonly shown = (layer: Layer): boolean => !this.hidden.has(layer.name ?? "");

  private addLegend(host: HTMLElement, layers: Layer[]): void {
    const named = new Map<string, Layer>();
    for (const layer of layers) if (layer.name && !named.has(layer.name)) named.set(layer.name, layer);
    if (named.size < 2) return;
    const entries = [...named].map(([name, layer]) =>
      toggle(layer.colour, name, this.shown(layer), (shown) => {
        if (shown) this.hidden.delete(name);
        else this.hidden.add(name);
        this.redraw();
      }),
    );
    host.append(make("div", { class: "legend" }, ...entries));
  }

  private whole(): Range {
    const all = this.panes.flatMap((pane) => pane.layers.flatMap((layer) => (layer.x ? [layer.x] : [])));
    return this.options.range ?? widened(extent(...all), this.options.margin ?? 0);
  }

  private draw(pen: Pen, width: number, height: number): void {
    const range = this.zoom ?? this.whole();
    const { left = 62, title, whole } = this.options;
    const strips = this.panes.map((pane) => {
      const layers = pane.layers.filter(this.shown);
      return {
        weight: pane.weight ?? 1,
        title: pane.title,
        scale: pane.scale,
        range: yRange(pane, layers, range),
        draw: (plot: Area) => {
          for (const layer of layers) layer.draw(pen, plot);
        },
      };
    });
    this.plots = drawStrips(pen, width, height, range, strips, {
      left,
      right: 12,
      axis: title ? 30 : 14,
      gap: 8,
      title,
      whole,
    });
  }

  private listen(canvas: HTMLCanvasElement): void {
    let from: number | null = null;
    const end = (event: PointerEvent) => {
      this.mark.style.display = "none";
      if (from !== null && Math.abs(event.offsetX - from) > 6)
        this.zoomTo([this.valueAt(from), this.valueAt(event.offsetX)]);
      from = null;
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (this.options.fixed || event.button !== 0 || !this.plots.length) return;
      from = event.offsetX;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.plots.length) return;
      if (from !== null && Math.abs(event.offsetX - from) > 4) this.markBetween(from, event.offsetX);
      this.point(event);
    });
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => this.leave());
    if (this.options.fixed) return;
    canvas.addEventListener("dblclick", () => this.zoomTo(null));
    canvas.tabIndex = 0;
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  /** Zoom at the pointer, with Ctrl or once the chart was clicked; else the page scrolls. */
  private wheel(event: WheelEvent): void {
    if (!this.plots.length || !(event.ctrlKey || event.metaKey || document.activeElement === event.target)) return;
    event.preventDefault();
    const [from, to] = this.zoom ?? this.whole();
    const by = Math.exp(Math.max(-1, Math.min(1, event.deltaY / 240)));
    const at = this.valueAt(event.offsetX);
    this.zoomTo([at - (at - from) * by, at + (to - at) * by]);
  }

  /** Arrows move and zoom, Backspace goes back, Escape and F show the whole. */
  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Backspace") {
      event.preventDefault();
      if (this.earlier.length) this.set(this.earlier.pop()!);
      return;
    }
    const [from, to] = this.zoom ?? this.whole();
    const by = (to - from) / 8;
    const ranges: Record<string, Range | null> = {
      ArrowLeft: [from - by, to - by],
      ArrowRight: [from + by, to + by],
      ArrowUp: [from + by, to - by],
      ArrowDown: [from - by, to + by],
      Escape: null,
      f: null,
      F: null,
    };
    const range = ranges[event.key];
    if (range === undefined) return;
    event.preventDefault();
    this.zoomTo(range);
  }

  /** Show a range of x, at most the whole; null is the whole. */
  private zoomTo(range: Range | null): void {
    this.earlier.push(this.zoom);
    if (this.earlier.length > HISTORY) this.earlier.shift();
    const [low, high] = this.whole();
    if (range === null) return this.set(null);
    const [a, b] = [Math.min(...range), Math.max(...range)];
    const wide = Math.min(b - a, high - low);
    const begin = Math.max(low, Math.min(high - wide, a));
    this.set(wide > 0 && wide < high - low ? [begin, begin + wide] : null);
  }

  private set(zoom: Range | null): void {
    this.zoom = zoom;
    this.options.zoomed?.(zoom);
    this.redraw();
  }

  private valueAt(px: number): number {
    const { box, xAt } = this.plots[0]!;
    return xAt(Math.max(box.left, Math.min(box.right, px)));
  }

  private markBetween(a: number, b: number): void {
    const { left, right } = this.plots[0]!.box;
    const inside = (px: number) => Math.max(left, Math.min(right, px));
    this.place(this.mark, Math.min(inside(a), inside(b)), Math.abs(inside(b) - inside(a)));
  }

  private place(node: HTMLElement, left: number, width: number): void {
    const [top, bottom] = [this.plots[0]!.box.top, this.plots[this.plots.length - 1]!.box.bottom];
    Object.assign(node.style, {
      display: "block",
      left: `${left}px`,
      width: `${width}px`,
      top: `${top}px`,
      height: `${bottom - top}px`,
    });
  }

  private point(event: PointerEvent): void {
    const [px, py] = [event.offsetX, event.offsetY];
    const plot = this.plots.find(
      ({ box }) => px >= box.left && px <= box.right && py >= box.top - 8 && py <= box.bottom + 8,
    );
    const tip = plot && this.options.tip(plot.xAt(px), plot, px, py, this.shown);
    if (!plot || !tip) {
      this.leave();
      return;
    }
    showTip(event, tip.lines);
    if (tip.x !== undefined) this.place(this.cross, plot.x(tip.x), 0);
  }

  private leave(): void {
    hideTip();
    this.cross.style.display = "none";
  }
}

/** The range of the values within a range of x, with some room. */
function yRange(pane: Pane, layers: Layer[], [from, to]: Range): Range {
  if (pane.range) return pane.range;
  let [low, high] = [Infinity, -Infinity];
  const take = (value: number) => {
    if (!Number.isFinite(value) || (pane.scale === "log" && value <= 0)) return;
    low = Math.min(low, value);
    high = Math.max(high, value);
  };
  for (const { x, y, y2, reach, rising } of layers) {
    reach?.forEach(take);
    const [first, end] = x && rising ? within(x, [from, to]) : [0, Infinity];
    for (const values of [y, y2]) {
      if (x && values)
        for (let k = first; k < Math.min(end, values.length); k++) if (x[k]! >= from && x[k]! <= to) take(values[k]!);
    }
  }
  if (!(low <= high)) return pane.scale === "log" ? [0.1, 1] : [0, 1];
  if (pane.scale === "log") return low === high ? [low / 2, high * 2] : [low / 1.2, high * 1.2];
  if (pane.zero) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
  const room = widened([low, high], 0.06);
  return pane.scale === "counts" ? [0, room[1]] : room;
}
