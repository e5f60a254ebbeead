// What can be laid over the values of a table: samples, mean error, data points.

import { overlay, pointsShown } from "../../instruments/coverage";
import type { EditedTable } from "../../replies";

export function CoverageChips({ own }: { own: EditedTable | null }) {
  const without = own === null || own.samples === null;
  const why = without ? "No criterion depends on this table.\n" : "";
  const toggle = (kind: "samples" | "error") => {
    overlay.value = overlay.value === kind ? "" : kind;
  };
  return (
    <>
      <button
        class="chip"
        disabled={without}
        aria-pressed={overlay.value === "samples"}
        title={`${why}Colour cells and surface by the number of training samples that inform each value, on a logarithmic scale`}
        onClick={() => toggle("samples")}
      >
        samples
      </button>
      <button
        class="chip"
        disabled={without}
        aria-pressed={overlay.value === "error"}
        title={`${why}Colour cells and surface by the mean error of these samples, model minus measurement: blue too low, red too high`}
        onClick={() => toggle("error")}
      >
        mean error
      </button>
      <button
        class="chip"
        disabled={without || own.axes.length === 0 || own.axes.length > 2}
        aria-pressed={pointsShown.value}
        title={`${why}Dots on surface and slices where training samples look the table up`}
        onClick={() => {
          pointsShown.value = !pointsShown.value;
        }}
      >
        points
      </button>
    </>
  );
}
