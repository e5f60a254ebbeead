// Pictures and tables of the page as files and in the clipboard: PNG, SVG, and text with tabs, as spreadsheets read it.

import { drawnIn, type Pen, reset } from "./drawing/canvas";
import { token } from "./drawing/colours";
import { SvgPen } from "./drawing/svg";
import { fileName, plainText } from "./plain-text";
import { failure, message, state } from "./store";

const SHARP = 2; // pixels of a PNG for each pixel of the page
const TITLE = 24; // height of the title above a picture
const EDGE = 8;

/** Something that can be copied: a picture, or a table. */
export interface Copied {
  kind: "picture" | "table";
  label: string;
  element: HTMLElement;
}

const nameOf = (element: Element): string =>
  element.closest("[data-figure]")?.getAttribute("data-figure") ||
  element.closest("[aria-label]")?.getAttribute("aria-label") ||
  element.closest(".pane")?.querySelector("h2")?.textContent ||
  "";

/** The picture or the table that an element of the page belongs to; null if none. */
export function copiedAt(element: Element | null): Copied | null {
  const host = element?.closest<HTMLElement>("[data-figure]") ?? element?.closest<HTMLElement>(".canvas");
  if (host?.querySelector("canvas")) return { kind: "picture", label: nameOf(host), element: host };
  const table = element?.closest<HTMLElement>("table.list, table.grid");
  return table ? { kind: "table", label: nameOf(table), element: table } : null;
}

/** All pictures and tables of the screen that are visible. */
export function copiedOnScreen(): Copied[] {
  const all = [...document.querySelectorAll("main .canvas, main table.list, main table.grid")]
    .filter((each) => each.checkVisibility?.() ?? true)
    .flatMap((each) => copiedAt(each) ?? []);
  return all.filter((each, k) => all.findIndex((other) => other.element === each.element) === k);
}

interface Size {
  width: number;
  height: number;
}

/** Draw a picture with a title above it. */
function drawAll(pen: Pen, { element, label }: Copied): void {
  const ground = element.getBoundingClientRect();
  pen.font = `600 12px ${token("font")}`;
  pen.fillStyle = token("ink");
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  pen.fillText(label, EDGE, TITLE / 2 + 2);
  const canvases = [...element.querySelectorAll("canvas")].map((canvas) => ({ canvas, own: drawnIn(canvas) }));
  for (const { canvas, own } of canvases.sort((a, b) => (a.own?.number ?? 0) - (b.own?.number ?? 0))) {
    if (own === null) continue;
    const at = canvas.getBoundingClientRect();
    pen.save();
    pen.translate(at.left - ground.left, at.top - ground.top + TITLE);
    reset(pen);
    own.draw(pen, own.width, own.height);
    pen.restore();
  }
  for (const legend of element.querySelectorAll("[data-legend]")) drawTexts(pen, legend, ground);
}

/** Draw the texts of an element where they stand on the page, and the lines of its keys. */
function drawTexts(pen: Pen, element: Element, ground: DOMRect): void {
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  const walker = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node !== null; node = walker.nextNode()) {
    const range = document.createRange();
    range.selectNodeContents(node);
    const at = range.getBoundingClientRect();
    const style = getComputedStyle(node.parentElement!);
    if (at.width === 0 || node.parentElement!.closest("button") || style.visibility === "hidden") continue;
    pen.font = `${style.fontWeight} ${style.fontSize} ${token("font")}`;
    pen.fillStyle = style.color;
    pen.fillText(node.textContent ?? "", at.left - ground.left, at.top + at.height / 2 - ground.top + TITLE);
  }
  for (const key of element.querySelectorAll("i")) {
    const [at, style] = [key.getBoundingClientRect(), getComputedStyle(key)];
    if (at.width === 0 || Number.parseFloat(style.borderTopWidth) === 0) continue;
    pen.fillStyle = style.borderTopColor;
    pen.fillRect(at.left - ground.left, at.top - ground.top + TITLE, at.width, 2);
  }
}

const sizeOf = ({ element }: Copied): Size => {
  const { width, height } = element.getBoundingClientRect();
  return { width: Math.ceil(width), height: Math.ceil(height) + TITLE };
};

export function svgOf(own: Copied): string {
  const { width, height } = sizeOf(own);
  const pen = new SvgPen(document.createElement("canvas").getContext("2d"), token("hatch"));
  drawAll(pen as unknown as Pen, own);
  return pen.picture(width, height, token("paper"), own.label);
}

export async function pngOf(own: Copied): Promise<Blob> {
  const { width, height } = sizeOf(own);
  const canvas = Object.assign(document.createElement("canvas"), { width: SHARP * width, height: SHARP * height });
  const pen = canvas.getContext("2d")!;
  pen.fillStyle = token("paper");
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.scale(SHARP, SHARP);
  drawAll(pen, own);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob === null ? reject(new Error("the picture is too large")) : resolve(blob))),
  );
}

const exact = new WeakMap<HTMLElement, () => string[][]>();

/** Have a table copied with other texts than it shows, such as numbers with all digits. */
export function copyAs(table: HTMLElement, rows: () => string[][]): void {
  exact.set(table, rows);
}

/** The text of a cell as a spreadsheet reads it: plain minus signs, no thin spaces, nothing for a missing value. */
function cellText(cell: HTMLTableCellElement): string {
  const field = cell.querySelector<HTMLInputElement | HTMLSelectElement>("input:not([type=checkbox]), select");
  const tick = cell.querySelector<HTMLInputElement>("input[type=checkbox]");
  const chosen = cell.querySelector(".seg [aria-pressed=true]");
  if (field !== null) return plainText(field.value);
  if (tick !== null) return tick.checked ? "1" : "0";
  if (chosen !== null) return plainText(chosen.textContent);
  const shown = cell.cloneNode(true) as HTMLElement;
  for (const each of shown.querySelectorAll(".btn, svg, .unseen")) each.remove();
  for (const each of shown.querySelectorAll("br")) each.replaceWith("\n");
  return plainText(shown.textContent);
}

export function tsvOf({ element }: Copied): string {
  const rows =
    exact.get(element)?.() ??
    [...(element as HTMLTableElement).rows].map((row) =>
      [...row.cells].flatMap((cell) => [cellText(cell), ...Array<string>(cell.colSpan - 1).fill("")]),
    );
  return `${rows.map((row) => row.join("\t")).join("\n")}\n`;
}

function download(blob: Blob, name: string): void {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  message.value = `Saved ${name} to the downloads of the browser`;
}

export type Way = "copy" | "png" | "svg" | "tsv";

/** What can be done with a picture or a table. */
export const WAYS: Record<Copied["kind"], [Way, string][]> = {
  picture: [
    ["copy", "Copy the picture"],
    ["png", "Save as PNG"],
    ["svg", "Save as SVG"],
  ],
  table: [
    ["copy", "Copy the table"],
    ["tsv", "Save as TSV"],
  ],
};

export async function take(own: Copied, way: Way): Promise<void> {
  const name = (ending: string) => fileName(state.value.project?.name ?? "", own.label, ending);
  try {
    if (way === "svg") download(new Blob([svgOf(own)], { type: "image/svg+xml" }), name("svg"));
    else if (way === "png") download(await pngOf(own), name("png"));
    else if (way === "tsv") download(new Blob([tsvOf(own)], { type: "text/tab-separated-values" }), name("tsv"));
    else if (own.kind === "table") await navigator.clipboard.writeText(tsvOf(own));
    else await navigator.clipboard.write([new ClipboardItem({ "image/png": pngOf(own) })]);
    if (way === "copy") message.value = `Copied ${own.label || `the ${own.kind}`}`;
  } catch (error) {
    failure.value = `The ${own.kind} could not be ${way === "copy" ? "copied" : "saved"}: ${(error as Error).message}`;
  }
}
