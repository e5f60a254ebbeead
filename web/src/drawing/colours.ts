// Colours of pictures: those of the style sheet, and the scales of maps.

export type Rgb = readonly [number, number, number];

const HEIGHTS: readonly Rgb[] = [[43, 64, 124], [36, 108, 158], [44, 152, 155], [108, 190, 122], [191, 214, 88], [247, 226, 98]];
const DIVERGING: readonly Rgb[] = [[33, 82, 163], [120, 164, 214], [247, 247, 247], [228, 146, 124], [178, 42, 36]];
const DIVERGING_DARK: readonly Rgb[] = [[88, 150, 240], [50, 82, 130], [30, 34, 40], [130, 66, 52], [240, 120, 100]];

const known = new Map<string, string>();

/** Return a colour of the style sheet, such as `ink` or `model`. */
export function token(name: string): string {
  let value = known.get(name);
  if (value === undefined) {
    value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    known.set(name, value);
  }
  return value;
}

/** Forget the colours of the theme before. */
export function themeChanged(): void {
  known.clear();
}

export const isDark = (): boolean => document.documentElement.dataset.theme === "dark";

function mix(stops: readonly Rgb[], share: number): Rgb {
  const at = Math.max(0, Math.min(1, Number.isFinite(share) ? share : 0)) * (stops.length - 1);
  const i = Math.min(Math.floor(at), stops.length - 2);
  const [a, b] = [stops[i]!, stops[i + 1]!];
  return [0, 1, 2].map((k) => Math.round(a[k]! + (at - i) * (b[k]! - a[k]!))) as unknown as Rgb;
}

/** Return the colour of a height, 0 to 1. */
export const height = (share: number): Rgb => mix(HEIGHTS, share);

/** Return the colour of a difference, -1 to 1. */
export const diverging = (share: number): Rgb => mix(isDark() ? DIVERGING_DARK : DIVERGING, (share + 1) / 2);

export const css = (colour: Rgb, opacity = 1): string => `rgba(${colour[0]},${colour[1]},${colour[2]},${opacity})`;
