// Numbers as the field writes them: tabular, with a true minus, in the precision that the values warrant.

const MINUS = "\u2212";
export const MISSING = "\u2013";

/** Write a number with a number of decimals. */
export function fixed(value: number, decimals: number): string {
  if (!Number.isFinite(value)) return value === Infinity ? "\u221e" : value === -Infinity ? `${MINUS}\u221e` : MISSING;
  const text = Math.abs(value).toFixed(decimals);
  return value < 0 && Number(text) !== 0 ? MINUS + text : text;
}

/** Write a number with significant digits; zeros behind the point stay, so that columns line up. */
export function significant(value: number, digits = 4): string {
  if (!Number.isFinite(value) || value === 0) return fixed(value, 0);
  const exponent = Math.floor(Math.log10(Math.abs(value)));
  if (exponent < -4 || exponent > 6) return (value < 0 ? MINUS : "") + Math.abs(value).toExponential(digits - 1);
  return fixed(value, Math.max(0, digits - 1 - exponent));
}

/** Write a number with significant digits, or a dash for one that is missing. */
export const numberText = (value: number | null | undefined, digits = 4): string => significant(value ?? NaN, digits);

/** Write a difference with its sign. */
export function signed(value: number, digits = 3): string {
  const text = significant(value, digits);
  return value > 0 ? `+${text}` : text;
}

/** Write a count; a thin space from 10 000 on. */
export function count(value: number): string {
  const text = String(Math.round(value));
  return value < 10_000 ? text : text.replace(/\B(?=(\d{3})+$)/g, "\u2009");
}

/** A number of things: `1 file`, `2 files`. */
export const counted = (number: number, noun: string): string => `${count(number)} ${noun}${number === 1 ? "" : "s"}`;

/** Return the decimals with which all numbers of a table can be told apart, at most four significant digits. */
export function tableDecimals(values: Iterable<number>): number {
  const known = [...values].filter(Number.isFinite);
  const largest = known.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
  const limit = largest === 0 ? 0 : Math.min(8, Math.max(0, 3 - Math.floor(Math.log10(largest))));
  let places = 0;
  for (const value of known) {
    if (places >= limit) return limit; // the first values of a fitted table say so
    places = Math.max(places, Number(value.toPrecision(10)).toString().split(".")[1]?.length ?? 0);
  }
  return Math.min(places, limit);
}

/** Read a number as typed: "1,5" and "1.5" are the same; null if it is none. */
export function parseNumber(text: string): number | null {
  const plain = text
    .trim()
    .replace(/[\s\u2009\u202f]/g, "")
    .replace(MINUS, "-")
    .replace("\u221e", "Infinity");
  const dotted = plain.includes(",") && !plain.includes(".") ? plain.replace(",", ".") : plain;
  if (!/^[+-]?(\d+\.?\d*|\.\d+|Infinity|inf)(e[+-]?\d+)?$/i.test(dotted)) return null;
  return Number(dotted.replace(/inf$/i, "Infinity"));
}

/** Write a number without the zeros that say nothing, as axis points are written. */
export function plain(value: number, digits = 5): string {
  const text = significant(value, digits);
  return text.includes(".") && !text.includes("e") ? text.replace(/\.?0+$/, "") : text;
}

/** A unit as it is written behind a number; nothing for a number without one, which files call `-` or `1`. */
export const unitText = (unit: string): string => (unit === "-" || unit === "1" ? "" : unit);

/** Write a title with its unit in brackets, if it has one. */
export const withUnit = (title: string, unit: string): string => (unitText(unit) ? `${title} [${unit}]` : title);

/** Return the smallest difference that the numbers of a table can show, see `tableFormat`; 0 if all are 0. */
export function shownDigit(values: Iterable<number>): number {
  const largest = Math.max(0, ...Array.from(values, Math.abs).filter(Number.isFinite));
  if (largest === 0) return 0;
  const digits = Math.floor(Math.log10(largest));
  return isExtreme(largest) ? 10 ** (digits - 2) : 10 ** -Math.min(8, Math.max(0, 3 - digits));
}

/** Numbers so large or small that each is written by its own digits. */
const isExtreme = (largest: number): boolean => largest >= 1e7 || (largest > 0 && largest < 1e-5);

/** Return a function that writes the numbers of a table with the same decimals. */
export function tableFormat(
  values: Iterable<number>,
  options: { signed?: boolean; decimals?: number } = {},
): (value: number) => string {
  const rounded = Array.from(values, (value) => Number(value.toPrecision(4)));
  const largest = Math.max(0, ...rounded.filter(Number.isFinite).map(Math.abs));
  const decimals = options.decimals ?? tableDecimals(rounded);
  const extreme = isExtreme(largest);
  return (value) => {
    const text = extreme ? significant(value, 3) : fixed(value, decimals);
    return options.signed && value > 0 && Number(text) !== 0 ? `+${text}` : text;
  };
}
