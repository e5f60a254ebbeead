// A pen that writes SVG: what is drawn on a canvas can be saved as a picture that scales. It has what the drawings use.

import type { Pen } from "./canvas";

const escaped = (text: string): string =>
  text.replace(/[&<>"]/g, (letter) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[letter]!);

/** A coordinate with a hundredth of a pixel. */
const short = (value: number): string => String(Math.round(value * 100) / 100);

const ANCHORS: Record<string, string> = { center: "middle", right: "end", end: "end" };
const SHIFTS: Record<string, number> = { middle: 0.35, top: 0.8, hanging: 0.8, bottom: -0.2 }; // of the height of a letter

/** Records drawing as the elements of an SVG picture. */
export class SvgPen {
  private readonly elements: string[] = [];
  private readonly definitions: string[] = [];
  private readonly saved: object[] = [];
  private readonly ruler: Pen | null;
  private path = "";
  fillStyle: unknown = "#000";
  strokeStyle = "#000";
  lineWidth = 1;
  lineJoin = "round";
  globalAlpha = 1;
  font = "11px sans-serif";
  textAlign = "left";
  textBaseline = "alphabetic";
  private dash: number[] = [];
  private transform = "";
  private clipId = "";

  /** `ruler` measures texts; `hatching` is the colour of patterns. */
  constructor(ruler: Pen | null, hatching: string) {
    this.ruler = ruler;
    this.definitions.push(
      `<pattern id="hatch" width="5" height="5" patternUnits="userSpaceOnUse"><path d="M-1,1L1,-1M0,5L5,0M4,6L6,4" stroke="${escaped(hatching)}" fill="none"/></pattern>`,
    );
  }

  save(): void {
    const { fillStyle, strokeStyle, lineWidth, lineJoin, globalAlpha, font, textAlign, textBaseline } = this;
    const { dash, transform, clipId } = this;
    this.saved.push({
      ...{ fillStyle, strokeStyle, lineWidth, lineJoin, globalAlpha, font, textAlign, textBaseline },
      ...{ dash, transform, clipId },
    });
  }
  restore(): void {
    Object.assign(this, this.saved.pop());
  }
  translate(x: number, y: number): void {
    this.transform += `translate(${short(x)} ${short(y)})`;
  }
  rotate(angle: number): void {
    this.transform += `rotate(${short((angle * 180) / Math.PI)})`;
  }
  getTransform(): { a: number } {
    return { a: 1 };
  }
  setLineDash(dash: number[]): void {
    this.dash = dash;
  }

  beginPath(): void {
    this.path = "";
  }
  moveTo(x: number, y: number): void {
    this.path += `M${short(x)},${short(y)}`;
  }
  lineTo(x: number, y: number): void {
    this.path += `${this.path === "" ? "M" : "L"}${short(x)},${short(y)}`;
  }
  closePath(): void {
    this.path += "Z";
  }
  rect(x: number, y: number, width: number, height: number): void {
    this.path += `M${short(x)},${short(y)}h${short(width)}v${short(height)}h${short(-width)}Z`;
  }
  arc(x: number, y: number, radius: number, from: number, to: number): void {
    const at = (angle: number) => `${short(x + radius * Math.cos(angle))},${short(y + radius * Math.sin(angle))}`;
    const start = `${this.path === "" || this.path.endsWith("Z") ? "M" : "L"}${at(from)}`;
    const [r, turn] = [short(radius), Math.abs(to - from)];
    const arcTo = (angle: number, large: number) => `A${r},${r} 0 ${large} ${to > from ? 1 : 0} ${at(angle)}`;
    // a whole circle has no arc of its own
    if (turn >= 2 * Math.PI - 1e-6) this.path += `${start}${arcTo(from + Math.PI, 0)}${arcTo(from, 0)}Z`;
    else this.path += `${start}${arcTo(to, turn > Math.PI ? 1 : 0)}`;
  }
  fill(): void {
    this.add(`<path d="${this.path}" fill="${this.paint(this.fillStyle)}"`);
  }
  stroke(): void {
    const { strokeStyle, lineWidth, lineJoin, dash } = this;
    const dashes = dash.length > 0 ? ` stroke-dasharray="${dash.join(" ")}"` : "";
    this.add(
      `<path d="${this.path}" fill="none" stroke="${this.paint(strokeStyle)}" stroke-width="${lineWidth}" stroke-linejoin="${lineJoin}"${dashes}`,
    );
  }
  clip(): void {
    const id = `clip${this.definitions.length}`;
    // within another one, as a canvas has it
    const within = this.clipId ? ` clip-path="url(#${this.clipId})"` : "";
    const moved = this.transform ? ` transform="${this.transform}"` : "";
    this.definitions.push(`<clipPath id="${id}"${within}><path d="${this.path}"${moved}/></clipPath>`);
    this.clipId = id;
  }

  fillRect(x: number, y: number, width: number, height: number): void {
    this.add(
      `<rect x="${short(x)}" y="${short(y)}" width="${short(width)}" height="${short(height)}" fill="${this.paint(this.fillStyle)}"`,
    );
  }
  strokeRect(x: number, y: number, width: number, height: number): void {
    const path = this.path;
    this.path = "";
    this.rect(x, y, width, height);
    this.stroke();
    this.path = path;
  }
  clearRect(): void {
    // the ground is drawn once, before everything
  }
  fillText(text: string, x: number, y: number): void {
    const { font, textAlign, textBaseline } = this;
    const size = Number.parseFloat(/(\d+(\.\d+)?)px/.exec(font)?.[1] ?? "11");
    const anchor = ANCHORS[textAlign] ? ` text-anchor="${ANCHORS[textAlign]}"` : "";
    const at = `x="${short(x)}" y="${short(y + (SHIFTS[textBaseline] ?? 0) * size)}"`;
    this.add(`<text ${at} style="font:${escaped(font)}" fill="${this.paint(this.fillStyle)}"${anchor}`, escaped(text));
  }
  measureText(text: string): { width: number } {
    if (this.ruler === null) return { width: 6 * text.length };
    this.ruler.font = this.font;
    return this.ruler.measureText(text);
  }
  createPattern(): { setTransform: () => void } {
    return { setTransform: () => {} };
  }

  /** Everything that was drawn, on a ground, as a picture of a size in pixels. */
  picture(width: number, height: number, ground: string, title: string): string {
    const head = `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}">`;
    const defs = `<title>${escaped(title)}</title><defs>${this.definitions.join("")}</defs>`;
    const paper = `<rect width="100%" height="100%" fill="${escaped(ground)}"/>`;
    return `${head}${defs}${paper}${this.elements.join("\n")}</svg>\n`;
  }

  /** A colour; the only pattern that the drawings use is the hatching. */
  private paint(style: unknown): string {
    return typeof style === "string" ? escaped(style) : "url(#hatch)";
  }
  private add(begun: string, text?: string): void {
    const { globalAlpha, transform, clipId } = this;
    const opacity = globalAlpha < 1 ? ` opacity="${short(globalAlpha)}"` : "";
    const moved = transform ? ` transform="${transform}"` : "";
    const end = text === undefined ? "/>" : `>${text}</text>`;
    const element = `${begun}${opacity}${moved}${end}`;
    this.elements.push(clipId ? `<g clip-path="url(#${clipId})">${element}</g>` : element);
  }
}
