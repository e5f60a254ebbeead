// The numbers of a table: x runs across and y down, as calibration tools show a map.

import { amount, cellColours } from "../drawing/colours";
import { plain, tableFormat, withUnit } from "../drawing/numbers";
import { choice, hideTip, make, showTip } from "./elements";
import type { ParameterFigure } from "./figures";
import type { Plane } from "./plane";

type Mode = "after" | "before" | "change" | "relative" | "deviation" | "samples";

/** Add the table, the choice of what it shows, and what its marks mean; returns a function that fills it again. */
export function addTable(host: HTMLElement, plane: Plane): () => void {
  const { f, changed } = plane;
  let mode: Mode = "after";
  const cells = make("div", { class: "scroll" });
  const fill = () => {
    cells.replaceChildren(tableOf(plane, mode));
  };
  const options: Record<string, Mode> = {
    [changed ? "after" : "value"]: "after",
    ...(changed && { before: "before", change: "change", "relative change": "relative" }),
    ...(f.deviation && { "standard deviation": "deviation" }),
    ...(f.samples && { "training samples": "samples" }),
  };
  const choose = (chosen: Mode) => {
    mode = chosen;
    fill();
  };
  host.append(make("div", { class: "legend choice-row" }, choice(options, mode, choose)), cells, ...marks(f));
  fill();
  return fill;
}

function shownValues({ f }: Plane, mode: Mode): number[] {
  const change = (k: number) => (f.after[k] ?? NaN) - (f.before[k] ?? NaN);
  const value: Record<Mode, (k: number) => number> = {
    after: (k) => f.after[k] ?? NaN,
    before: (k) => f.before[k] ?? NaN,
    change,
    relative: (k) => (f.before[k] ? (100 * change(k)) / Math.abs(f.before[k]) : NaN),
    deviation: (k) => (f.deviation![k] === -1 ? Infinity : (f.deviation![k] ?? NaN)),
    samples: (k) => f.samples![k]!,
  };
  return f.after.map((_, k) => value[mode](k));
}

/** Colours of heights and differences are toned down by the style sheet; those of amounts are as they are. */
function shownColours(values: number[], mode: Mode): (string | null)[] {
  if (mode === "change" || mode === "relative") return cellColours(values, "difference");
  const finite = values.filter(Number.isFinite);
  const high = Math.max(0, ...finite);
  if (mode === "deviation" || mode === "samples")
    return values.map((value) =>
      Number.isFinite(value) && high > 0 ? amount(value / high, mode === "samples" ? "blue" : "amber") : null,
    );
  return new Set(finite).size > 1 ? cellColours(values, "height") : values.map(() => null);
}

function tableOf(plane: Plane, mode: Mode): HTMLElement {
  const { f, nx, ny, x, y } = plane;
  const values = plane.pick(shownValues(plane, mode));
  const colours = shownColours(values, mode);
  const format = mode === "samples" ? String : tableFormat(values);
  const cell = (i: number, j: number) => {
    const node = make("td", { class: marksOf(f, plane.cell(i, j)) }, format(values[i * ny + j]!));
    const colour = colours[i * ny + j];
    if (colour) node.style.setProperty("--c", colour);
    node.addEventListener("pointermove", (event) => showTip(event, plane.describe(i, j)));
    node.addEventListener("pointerleave", hideTip);
    return node;
  };
  const corner =
    y === null ? withUnit(x.title, x.unit) : `${withUnit(y.title, y.unit)} ↓  ${withUnit(x.title, x.unit)} →`;
  const head = make(
    "tr",
    {},
    make("th", { class: "corner" }, corner),
    ...x.points.map((point) => make("th", { scope: "col" }, plain(point, 5))),
  );
  const rows = Array.from({ length: ny }, (_, j) =>
    make(
      "tr",
      {},
      make("th", { scope: "row" }, y === null ? withUnit(f.name, f.unit) : plain(y.points[j]!, 5)),
      ...Array.from({ length: nx }, (_, i) => cell(i, j)),
    ),
  );
  const kind = ["grid", nx > 14 ? "dense" : "", mode === "deviation" || mode === "samples" ? "amounts" : ""].join(" ");
  return make("table", { class: kind }, make("thead", {}, head), make("tbody", {}, ...rows));
}

function marksOf(f: ParameterFigure, k: number): string {
  const names = [
    f.samples?.[k] === 0 && "nodata",
    f.informed?.[k] === 0 && "kept",
    f.bound[k] !== 0 && "bound",
    f.locked[k] === 1 && "locked",
  ];
  return names.filter(Boolean).join(" ");
}

/** What the marks of the cells mean; only those that occur. */
function marks(f: ParameterFigure): HTMLElement[] {
  const meanings: [boolean | undefined, string, string][] = [
    [f.samples?.includes(0), "nodata", "no training data"],
    [f.informed?.includes(0), "nodata kept", "undetermined: start kept"],
    [f.bound.some((side) => side !== 0), "bound", "at a bound"],
    [f.locked.includes(1), "locked", "locked"],
  ];
  const entries = meanings
    .filter(([occurs]) => occurs)
    .map(([, kind, text]) => make("span", {}, make("i", { class: `sample ${kind}` }), text));
  return entries.length ? [make("div", { class: "marks" }, ...entries)] : [];
}
