// A place of a text file that is to be shown; the editor of that file goes there.

import { signal } from "@preact/signals";

export interface Place {
  file: string;
  line: number;
  column: number;
}
export const jump = signal<Place | null>(null);
