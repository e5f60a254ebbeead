// The plots: strips over time or a scatter matrix, calculated over measured, errors, and the evidence behind a
// selection.

import { computed, effect, signal } from "@preact/signals";
import { useLayoutEffect } from "preact/hooks";
import { fixed } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { Overview } from "../instruments/overview";
import { Strips } from "../instruments/strips";
import { matrixOpen, stepCursor } from "../plot-data";
import {
  back,
  chooseCriterion,
  clearMarks,
  criterionNumber,
  cursor,
  dataset,
  datasetNumber,
  decimalsOfTime,
  fit,
  hover,
  only,
  part,
  range,
  shift,
  showDataset,
  stretch,
  tool,
  unitOfTime,
  visible,
  zoom,
  zoomAt,
} from "../plots";
import { screen, state } from "../store";
import { searching } from "../strip-rows";
import { BrushBar, describeBrush } from "./plots/brush-bar";
import { HistogramPane } from "./plots/histogram-pane";
import { Legends } from "./plots/legends";
import { Matrix } from "./plots/matrix";
import { PointPane, RangePane, SamplePane } from "./plots/part-panes";
import { ScatterPane } from "./plots/scatter-pane";
import { SignalSearch } from "./plots/signal-search";

const query = matchMedia("(min-width: 1700px)");
const wide = signal(query.matches);
query.addEventListener("change", () => {
  wide.value = query.matches;
});

effect(() => {
  if (range.value !== null) part.value = "range";
});
effect(() => {
  if (cursor.value !== null && screen.peek() === "plots") part.value = "sample";
});

export function Plots() {
  useLayoutEffect(() => {
    addEventListener("keydown", key);
    return () => removeEventListener("keydown", key);
  }, []);
  const deep = !wide.value && part.value !== "point";
  return (
    <>
      <main class={`plots ${deep ? "deep" : ""} ${searching.value ? "searching" : ""}`}>
        <Tools />
        {searching.value && <SignalSearch />}
        {matrixOpen.value ? (
          <div class="pane strip-pane">
            <Matrix />
            <BrushBar />
          </div>
        ) : (
          <section class="pane strip-pane" data-figure={`Strips of ${dataset.value?.name ?? ""}`}>
            <div class="ov">
              <div class="leg">
                <span class="q cut">whole {dataset.value?.name}</span>
              </div>
              <Overview />
            </div>
            {empty.value ? <p class="pad q">{empty.value}</p> : <Strips legends={<Legends />} />}
            <BrushBar />
          </section>
        )}
        <ScatterPane />
        {!deep && <HistogramPane />}
        {(wide.value || part.value === "point") && <PointPane tabs={!wide.value} />}
        {(wide.value || part.value === "sample") && <SamplePane tabs={!wide.value} />}
        {(wide.value || part.value === "range") && <RangePane tabs={!wide.value} />}
      </main>
      <Footer>
        <Key keys={["←", "→"]} text="sample by sample" />
        <Key keys={["R"]} text="range" />
        <Key keys={["B"]} text="brush" />
        <Key keys={["F"]} text="fit" />
        <Key keys={["W"]} text="whole" />
        <Key keys={["Backspace"]} text="back" />
        <Key keys={["S"]} text="signals" />
        <Key keys={["Esc"]} text="no selection" />
      </Footer>
    </>
  );
}

const empty = computed(() =>
  dataset.value === undefined
    ? "Add a recording on the Data screen, and write a function: then its signals are drawn here."
    : "",
);

function Tools() {
  const { begin, end } = visible.value;
  const own = dataset.value;
  const { criteria, datasets } = state.value;
  const places = decimalsOfTime(end - begin);
  return (
    <section class="pane tool" aria-label="Tools">
      <div class="head">
        <select
          class="field small"
          aria-label="Dataset"
          title="The dataset that all plots show"
          value={datasetNumber.value}
          onChange={(event) => showDataset(Number(event.currentTarget.value))}
        >
          {datasets.map((each, k) => (
            <option value={k}>
              {each.name} · {each.use}
            </option>
          ))}
        </select>
        {criteria.length > 1 && (
          <select
            class="field small"
            id="criterion"
            aria-label="Criterion"
            title="The criterion whose errors are plotted"
            value={criterionNumber.value}
            onChange={(event) => chooseCriterion(Number(event.currentTarget.value))}
          >
            {criteria.map((each, k) => (
              <option value={k}>{each.node}</option>
            ))}
          </select>
        )}
        <button
          class="btn small"
          id="signals"
          aria-pressed={searching.value}
          title="Search channels, nodes, errors and targets (S)"
          onClick={() => {
            searching.value = !searching.value;
          }}
        >
          <Icon name="plus" />
          Signal
        </button>
        <span class="sep" />
        <span class="seg tight" role="group" aria-label="View">
          <button
            aria-pressed={!matrixOpen.value}
            onClick={() => {
              matrixOpen.value = false;
            }}
          >
            Strips
          </button>
          <button
            aria-pressed={matrixOpen.value}
            title="Each signal over each other one (M)"
            onClick={() => {
              matrixOpen.value = true;
            }}
          >
            Matrix
          </button>
        </span>
        {!matrixOpen.value && (
          <>
            <span class="seg tight" role="group" aria-label="What dragging does">
              {(["zoom", "range", "brush"] as const).map((name) => (
                <button
                  aria-pressed={tool.value === name}
                  title={TIPS[name]}
                  onClick={() => {
                    tool.value = name;
                  }}
                >
                  {name[0]!.toUpperCase() + name.slice(1)}
                </button>
              ))}
            </span>
            <button class="btn small" title="The stretch before (Backspace)" onClick={back}>
              Back
            </button>
            <button class="btn small" title="Fit the time axis to what is brushed or measured (F)" onClick={fit}>
              Fit
            </button>
            <button
              class="btn small"
              title="The whole dataset (W)"
              disabled={stretch.value === null}
              onClick={() => zoom(null)}
            >
              Whole
            </button>
            <span class="ink span">
              {fixed(begin, places)} … {fixed(end, places)} {unitOfTime.value}
            </span>
            {own && stretch.value !== null && (
              <span class="q of">
                of {fixed(own.end - own.begin, places)} {unitOfTime.value}
              </span>
            )}
          </>
        )}
        {only.value !== null && (
          <button
            class="chip"
            id="only"
            aria-pressed="true"
            title={`All plots show only ${describeBrush(only.value)}. Click to show all samples.`}
            onClick={() => {
              only.value = null;
            }}
          >
            only brushed samples <i>×</i>
          </button>
        )}
        <span class="right">
          {(["measured", "model", "before", "error"] as const).map((name) => (
            <span class="key">
              <i style={{ borderColor: `var(--${name})` }} />
              {{ measured: "measured", model: "now", before: "start", error: "error" }[name]}
            </span>
          ))}
          <span class="key">
            <i class="dot" style={{ background: "var(--lit)" }} />
            brushed
          </span>
        </span>
      </div>
    </section>
  );
}

const TIPS = {
  zoom: "Drag to zoom, wheel zooms at the mouse (Z). A click puts the cursor there.",
  range: "Drag to measure differences and statistics (R)",
  brush: "Drag to light up samples in all plots and tables (B); Shift+drag does it with any tool",
};

function key(event: KeyboardEvent): void {
  if (event.ctrlKey || event.metaKey || event.altKey || (event.target as HTMLElement).closest("input,select,textarea"))
    return;
  const { begin, end } = visible.value;
  const [wide, by] = [end - begin, event.shiftKey ? 10 : 1];
  const middle = cursor.value ?? hover.value ?? (begin + end) / 2;
  const actions: Record<string, () => void> = {
    r: () => {
      tool.value = "range";
    },
    b: () => {
      tool.value = "brush";
    },
    z: () => {
      tool.value = "zoom";
    },
    s: () => {
      searching.value = !searching.value;
    },
    m: () => {
      matrixOpen.value = !matrixOpen.value;
    },
    f: fit,
    w: () => zoom(null),
    Backspace: back,
    Escape: clearMarks,
    ArrowLeft: () => stepCursor(-by),
    ArrowRight: () => stepCursor(by),
    Home: () => stepCursor(-1e12),
    End: () => stepCursor(1e12),
    PageUp: () => shift(-0.8 * wide),
    PageDown: () => shift(0.8 * wide),
    ArrowUp: () => zoomAt(middle, 0.75),
    ArrowDown: () => zoomAt(middle, 1 / 0.75),
  };
  const action = actions[event.key] ?? actions[event.key.toLowerCase()];
  if (action === undefined) return;
  event.preventDefault();
  action();
}
