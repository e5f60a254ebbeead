// A place of a text file that is to be shown; the editor of that file goes there.
import { scoped } from "./scope";

export interface Place {
  file: string;
  line: number;
  column: number;
}
export const jump = scoped<Place | null>(null);
