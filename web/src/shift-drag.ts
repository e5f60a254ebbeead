// A drag along the small picture of a channel: by how much it shifts the channel.

export interface FileSpan {
  timed: boolean;
  begin: number;
  end: number;
}

const MARGIN = 2; // pixels at both sides of the line of a file

/** The stretch of a picture in which the line of a file is drawn: all files side by side, equally wide. */
export function slotOf(file: number, files: number, wide: number): [left: number, right: number] {
  const each = wide / Math.max(1, files);
  return [file * each + MARGIN, (file + 1) * each - MARGIN];
}

/** How many seconds a pixel of the line of a file is; 0 if the file has no time stamps. */
export function secondsPerPixel(file: number, files: readonly FileSpan[], wide: number): number {
  const span = files[file];
  const [left, right] = slotOf(file, files.length, wide);
  return span === undefined || !span.timed || right <= left ? 0 : Math.max(0, span.end - span.begin) / (right - left);
}

/**
 * The shift that a drag asks for, in s and whole samples, by the scale of the file at which it begins; 0 if that has no
 * time stamps.
 */
export function shiftOfDrag(from: number, to: number, wide: number, files: readonly FileSpan[], step: number): number {
  const file = Math.min(files.length - 1, Math.max(0, Math.floor((from / wide) * files.length)));
  const seconds = (to - from) * secondsPerPixel(file, files, wide);
  return seconds === 0 || !(step > 0) ? 0 : Number((Math.round(seconds / step) * step).toPrecision(6)) || 0;
}
