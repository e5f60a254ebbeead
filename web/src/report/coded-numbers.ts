// Columns of numbers as `report/coded_numbers.py` writes them: differences of whole steps, bytes by significance,
// deflate.

export interface CodedNumbers {
  count: number;
  first: number; // the least number
  step: number;
  order: number; // how often differences were taken
  planes: number; // bytes of a difference
  data: string;
  gaps?: string; // a bit for each number, 1 if it is not known
}

/** Whether this browser can decode numbers. */
export const canDecode = typeof DecompressionStream !== "undefined";

async function inflate(text: string): Promise<Uint8Array> {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return the numbers; NaN for those that are not known. */
export async function decodeNumbers({
  count,
  first,
  step,
  order,
  planes,
  data,
  gaps,
}: CodedNumbers): Promise<Float64Array> {
  const bytes = await inflate(data);
  const values = new Float64Array(count);
  const weights = Array.from({ length: planes }, (_, plane) => 256 ** plane);
  for (let k = 0; k < count; k++) {
    let code = 0;
    for (let plane = 0; plane < planes; plane++) code += bytes[plane * count + k]! * weights[plane]!;
    values[k] = code % 2 ? -(code + 1) / 2 : code / 2;
  }
  for (let time = 0; time < order; time++) {
    let sum = 0;
    for (let k = 0; k < count; k++) values[k] = sum += values[k]!;
  }
  for (let k = 0; k < count; k++) values[k] = first + step * values[k]!;
  if (gaps !== undefined) {
    const bits = await inflate(gaps);
    for (let k = 0; k < count; k++) if (bits[k >> 3]! & (1 << (k & 7))) values[k] = NaN;
  }
  return values;
}
