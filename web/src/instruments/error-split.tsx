// The error at the cursor: what is measured and calculated there, each node before and after, and the change of each
// table that alone would take the error away. Mount `ErrorSplit` in a pane; it follows the cursor of the plots.

import { computed, effect, signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { newest } from "../connection";
import { MISSING, numberText, plain, signed } from "../drawing/numbers";
import { chooseCriterion, criterionNumber, cursor, datasetNumber } from "../plots";
import type { CorrectionRow, NodeValue, SplitError } from "../replies";
import { scoped } from "../scope";
import { open, request, screen, selection, settled } from "../store";
import "./error-split.css";

export const split = scoped<SplitError | null>(null);
const mounted = signal(0); // panes that show it

const load = newest(async (given: { dataset: number; position: number; criterion: number }) => {
  const reply = await request("split", given);
  if (reply !== null) split.value = reply.head;
});

/** The position of the cursor; the middle of the dataset until it is set. */
const position = computed(() => {
  const own = settled.value.datasets[datasetNumber.value];
  return own === undefined ? null : Math.min(own.end, Math.max(own.begin, cursor.value ?? (own.begin + own.end) / 2));
});

effect(() => {
  const { criteria } = settled.value;
  if (mounted.value === 0) return;
  if (position.value === null || criteria.length === 0) split.value = null;
  else load({ dataset: datasetNumber.value, position: position.value, criterion: criterionNumber.value });
});

/** Ask for the split while a component is shown. */
export function useSplit(): SplitError | null {
  useEffect(() => {
    mounted.value += 1;
    return () => {
      mounted.value -= 1;
    };
  }, []);
  return split.value;
}

/** Where the cursor is, in words: `bench, point 479`. */
export function placeText(own: SplitError): string {
  const data = settled.value.datasets[own.dataset];
  return data === undefined
    ? ""
    : `${data.name}, ${data.timed ? `${plain(own.position, 7)} s` : `point ${own.sample + 1} of ${data.samples}`}`;
}

/**
 * Measurement and model at the cursor, and what would take the error away; with `nodes`, the value of each node, too.
 */
export function ErrorSplit({ nodes = false }: { nodes?: boolean }) {
  const own = useSplit();
  if (own === null)
    return (
      <p class="pad q">Map the inputs to channels, and add a criterion: then the error at the cursor is shown here.</p>
    );
  return (
    <div class="split">
      <ErrorFacts own={own} />
      {nodes && <NodeTable own={own} />}
      <div class="head mid">
        <h2>What would take this error away</h2>
        <span class="sub">one table at a time</span>
      </div>
      <Corrections own={own} />
    </div>
  );
}

export function ErrorFacts({ own }: { own: SplitError }) {
  const { criteria } = settled.value;
  return (
    <dl class="facts pad">
      {criteria.length > 1 && (
        <>
          <dt>criterion</dt>
          <dd>
            <select
              class="field small"
              aria-label="Criterion"
              value={own.criterion}
              onChange={(event) => chooseCriterion(Number(event.currentTarget.value))}
            >
              {criteria.map((each, k) => (
                <option value={k}>{each.node}</option>
              ))}
            </select>
          </dd>
        </>
      )}
      <dt>measured</dt>
      <dd>
        {numberText(own.measured)} <u>{own.unit}</u>
      </dd>
      <dt>{own.node}, start → now</dt>
      <dd>
        <span class="q">{numberText(valueAt(own)?.start)}</span> → {numberText(valueAt(own)?.now)} <u>{own.unit}</u>
      </dd>
      <dt>error, start → now</dt>
      <dd>
        {own.difference.now === null ? (
          <span class="q" title="This sample is not scored: warm-up, a gap, or no measurement">
            not scored
          </span>
        ) : (
          <>
            <span class="q">{own.difference.start === null ? MISSING : signed(own.difference.start, 4)}</span> →{" "}
            <b class="bad" data-split="error">
              {signed(own.difference.now, 4)}
            </b>{" "}
            <u>{own.unit}</u>
          </>
        )}
      </dd>
    </dl>
  );
}

const valueAt = (own: SplitError): NodeValue | undefined => own.nodes.find((node) => node.name === own.node);

export function NodeTable({ own }: { own: SplitError }) {
  return (
    <table class="list">
      <thead>
        <tr>
          <th>node</th>
          <th>unit</th>
          <th class="num">start</th>
          <th class="num">now</th>
          <th class="num">change</th>
        </tr>
      </thead>
      <tbody>
        {own.nodes.map((node) => (
          <tr key={node.name}>
            <td class="cut">
              <b>{node.name}</b>
            </td>
            <td class="q">{node.unit}</td>
            <td class="num q">{numberText(node.start)}</td>
            <td class="num ink">{numberText(node.now)}</td>
            <td class="num">
              {node.now === null || node.start === null || node.now === node.start ? "" : signed(node.now - node.start)}
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

export function Corrections({
  own,
  chosen = "",
  choose,
}: {
  own: SplitError;
  chosen?: string;
  choose?: (node: string) => void;
}) {
  if (own.difference.now === null)
    return <p class="pad q">This sample is not scored. Move the cursor to one that is.</p>;
  return (
    <table class="list fix" data-split="corrections">
      <thead>
        <tr>
          <th>node</th>
          <th>table</th>
          <th class="num" title={`Change of ${own.node} if all values that act here are raised by 1`}>
            slope
          </th>
          <th class="num" title="What to add to the values that act here, to first order">
            change needed
          </th>
          <th title="The change as a share of the range of the table's values, or what is in its way">of range</th>
        </tr>
      </thead>
      <tbody>
        {own.corrections.map((each) => (
          <tr
            key={each.parameter}
            class={`${each.obstacle ? "off" : ""} ${chosen !== "" && each.nodes.includes(chosen) ? "on" : ""}`}
            onClick={() => choose?.(each.nodes[0] ?? "")}
          >
            <td class="mono cut">{each.nodes[0] ?? MISSING}</td>
            <td class="cut">
              <button
                class="link"
                title={`Open ${each.parameter} at the value that acts most`}
                onClick={(event) => {
                  event.stopPropagation();
                  openAt(each);
                }}
              >
                {each.parameter}
              </button>
              {!each.free && (
                <>
                  {" "}
                  <span class="tag" title="No pattern of [calibration] free matches it">
                    fixed
                  </span>
                </>
              )}
            </td>
            <td class="num">{each.slope === null || each.slope === 0 ? MISSING : signed(each.slope)}</td>
            <td class={`num ${each.obstacle ? "" : "ink"}`} title={reason(each)}>
              {each.obstacle ? (
                "out of reach"
              ) : (
                <>
                  {signed(each.change!)} <u>{each.unit === "-" ? "" : each.unit}</u>
                </>
              )}
            </td>
            <td title={reason(each)}>
              {each.obstacle
                ? short(each)
                : each.share !== null && (
                    <>
                      <span class="bar q" style={{ width: `${Math.min(48, Math.max(2, each.share * 48))}px` }} />{" "}
                      <span class="q">{each.share > 9.99 ? "> 999" : Math.round(each.share * 100)} %</span>
                    </>
                  )}
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

const short = (each: CorrectionRow): string =>
  each.obstacle === "bounds" ? `bounds: ${signed(each.allowed ?? 0)}` : each.obstacle;

function reason(each: CorrectionRow): string {
  switch (each.obstacle) {
    case "":
      return `${signed(each.change!, 5)} ${each.unit} on the values that act here`;
    case "bounds":
      return `${signed(each.change!, 5)} ${each.unit} would be needed; the bounds allow ${signed(each.allowed ?? 0, 4)} ${each.unit}`;
    case "locked":
      return `${signed(each.change!, 5)} ${each.unit} would be needed, but a value that acts here is locked`;
    case "does not act":
      return "The result does not depend on this table at this sample";
  }
}

/** Open a parameter with the value selected that acts most at the cursor. */
function openAt(each: CorrectionRow): void {
  open(each.parameter);
  screen.value = "parameters";
  const columns = settled.value.parameters.find((p) => p.name === each.parameter)?.shape[1] ?? 1;
  const at: [number, number] = [Math.floor(each.cell / columns), each.cell % columns];
  selection.value = { x: [at[0], at[0]], y: [at[1], at[1]], active: at };
}
