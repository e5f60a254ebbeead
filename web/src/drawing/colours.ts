// Colours of pictures: those of the style sheet, and the scales of maps.

export type Rgb = readonly [number, number, number];
type Scale = readonly Rgb[];

const HEIGHTS: Scale = [
  [43, 64, 124],
  [36, 108, 158],
  [44, 152, 155],
  [108, 190, 122],
  [191, 214, 88],
  [247, 226, 98],
];
const DIVERGING: Scale = [
  [33, 82, 163],
  [120, 164, 214],
  [247, 247, 247],
  [228, 146, 124],
  [178, 42, 36],
];
const DIVERGING_DARK: Scale = [
  [88, 150, 240],
  [50, 82, 130],
  [30, 34, 40],
  [130, 66, 52],
  [240, 120, 100],
];
const FAMILY: Scale = [
  [200, 120, 50],
  [196, 60, 80],
  [110, 60, 150],
  [31, 95, 191],
];
const FAMILY_DARK: Scale = [
  [230, 160, 90],
  [236, 110, 125],
  [178, 130, 222],
  [116, 167, 242],
];
const DEVIATIONS: Scale = [
  [248, 248, 247],
  [250, 231, 203],
  [243, 188, 122],
  [217, 116, 62],
  [158, 34, 34],
];
const DEVIATIONS_DARK: Scale = [
  [30, 35, 42],
  [66, 58, 50],
  [128, 92, 54],
  [196, 112, 62],
  [240, 92, 74],
];
const AMOUNTS = { blue: [120, 164, 214], amber: [240, 164, 88] } as const;

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

function mix(stops: Scale, share: number): Rgb {
  const at = Math.max(0, Math.min(1, Number.isFinite(share) ? share : 0)) * (stops.length - 1);
  const i = Math.min(Math.floor(at), stops.length - 2);
  const [a, b] = [stops[i]!, stops[i + 1]!];
  return [0, 1, 2].map((k) => Math.round(a[k]! + (at - i) * (b[k]! - a[k]!))) as unknown as Rgb;
}

/** Return the colour of a height, 0 to 1. */
export const height = (share: number): Rgb => mix(HEIGHTS, share);

/** Return the colour of a difference, -1 to 1. */
export const diverging = (share: number): Rgb => mix(isDark() ? DIVERGING_DARK : DIVERGING, (share + 1) / 2);

/** Return the colour of a deviation, 0 to 1. */
export const deviation = (share: number): Rgb => mix(isDark() ? DEVIATIONS_DARK : DEVIATIONS, share);

/** Return the colour of a line among several of one family, 0 to 1. */
export const family = (share: number, dark = isDark()): Rgb => mix(dark ? FAMILY_DARK : FAMILY, share);

/** Return the colour of an amount, 0 to 1, which lets the paper through: samples in blue, errors in amber. */
export const amount = (share: number, hue: keyof typeof AMOUNTS): string =>
  css(AMOUNTS[hue], Math.max(0, Math.min(1, share)));

export const css = (colour: Rgb, opacity = 1): string => `rgba(${colour[0]},${colour[1]},${colour[2]},${opacity})`;

/** Return the colours of the cells of a table: by height, or by difference; null where there is no number. */
export function cellColours(values: readonly number[], kind: "height" | "difference"): (string | null)[] {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  const reach = Math.max(Math.abs(low), Math.abs(high)) || 1;
  const paint =
    kind === "difference"
      ? (value: number) => diverging(value / reach)
      : (value: number) => height(high > low ? (value - low) / (high - low) : 0.5);
  return values.map((value) => (Number.isFinite(value) ? css(paint(value)) : null));
}
