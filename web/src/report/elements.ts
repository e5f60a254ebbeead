// Elements of the page: made, toggled, and the tooltip.

import { token } from "../drawing/colours";

type Child = Node | string | null | undefined;

/** Make an element with attributes and children. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Return a colour of the style sheet by its name; any other as it is. */
export const paint = (colour: string): string => (/^[a-z-]+$/.test(colour) ? token(colour) : colour);

/** Make a sample of a colour, which follows the theme if it is of the style sheet. */
export function swatch(colour: string): HTMLElement {
  const node = make("i");
  node.style.background = /^[a-z-]+$/.test(colour) ? `var(--${colour})` : colour;
  return node;
}

/** Make the button of a legend, which hides and shows what it names. */
export function toggle(
  colour: string,
  name: string,
  shown: boolean,
  change: (shown: boolean) => void,
): HTMLButtonElement {
  const button = make("button", { type: "button", "aria-pressed": String(shown) }, swatch(colour), name);
  button.addEventListener("click", () => {
    const next = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(next));
    change(next);
  });
  return button;
}

/** Make buttons of which one is pressed, from the names and values of the options. */
export function choice<T extends string>(
  options: Record<string, T>,
  selected: T,
  choose: (value: T) => void,
): HTMLElement {
  const buttons = Object.entries(options).map(([name, value]) => {
    const button = make("button", { type: "button", "aria-pressed": String(value === selected) }, name);
    button.addEventListener("click", () => {
      for (const each of buttons) each.setAttribute("aria-pressed", String(each === button));
      choose(value);
    });
    return button;
  });
  return make("span", { class: "choice" }, ...buttons);
}

export type TipLine = [text: string, colour?: string];

let tip: HTMLElement | null = null;

/** Show lines beside the pointer. */
export function showTip(event: PointerEvent, lines: TipLine[]): void {
  if (tip === null) {
    tip = make("div", { class: "tooltip" });
    document.body.append(tip);
  }
  tip.replaceChildren(
    ...lines.map(([text, colour]) => {
      const line = make("div", {}, text);
      if (colour) line.style.color = paint(colour);
      return line;
    }),
  );
  tip.style.display = "block";
  const fits = event.clientX + 16 + tip.offsetWidth < innerWidth;
  tip.style.left = `${fits ? event.clientX + 14 : event.clientX - tip.offsetWidth - 12}px`;
  tip.style.top = `${Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 6)}px`;
}

export function hideTip(): void {
  if (tip !== null) tip.style.display = "none";
}
