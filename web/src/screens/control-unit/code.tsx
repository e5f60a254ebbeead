// The C code: its file as it will be written, and its comparison with the simulation.

import {
  busy,
  code,
  codeStale,
  compareCode,
  name,
  type Precision,
  precision,
  rounds,
  waitsFor,
} from "../../control-unit";
import { count, counted, MISSING, significant, unitText } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import { LineInput } from "../../inputs";
import type { ComparedCode, ControlUnit } from "../../replies";

export function CodePane({ own }: { own: ControlUnit }) {
  const reply = code.value;
  return (
    <section class="pane code" aria-label="C code">
      <div class="head">
        <h2>C code</h2>
        <span class={`sub ${codeStale.value ? "warn" : ""}`}>
          {codeStale.value ? "older than the values" : "C99, no heap"}
        </span>
        <span class="right">
          <button
            class="btn small"
            id="compare-code"
            disabled={reply === null || codeStale.value || own.compiler === "" || busy.value !== ""}
            title={own.compiler ? `Compile it with ${own.compiler}, and run it over all data (c)` : NO_COMPILER}
            onClick={() => void compareCode()}
          >
            Compile and compare
          </button>
        </span>
      </div>
      <div class="options">
        <span class="q">precision</span>
        <Segment
          label="Precision"
          options={["double", "float"]}
          chosen={precision.value}
          choose={(option) => {
            precision.value = option as Precision;
          }}
        />
        <span class="q">name</span>
        <span class="field small mono" style={{ width: "150px" }} title="With which the names of the code begin">
          <LineInput
            label="Name of the code"
            placeholder={reply?.name ?? ""}
            text={name.value}
            enter={(text) => {
              name.value = text;
            }}
          />
        </span>
      </div>
      {reply !== null && (
        <div class={`numbers ${codeStale.value ? "old" : ""}`}>
          <span>
            <small>values and axes</small>
            <b>{count(reply.size)}</b> B
          </span>
          <span>
            <small>lines</small>
            <b>{count(reply.lines)}</b>
          </span>
          <Compared own={reply.compared} compiler={own.compiler} />
        </div>
      )}
      {reply?.findings
        .filter((text) => !text.includes("is not checked"))
        .map((text) => (
          <p class="note">{text}</p>
        ))}
      {reply === null ? (
        <p class="pad q">
          {rounds.value && waitsFor.value
            ? "The file has the rounded values: it is shown once they are rounded."
            : "Writing the code"}
        </p>
      ) : (
        <div class={`source ${codeStale.value ? "old" : ""}`} tabIndex={0}>
          <pre id="c-code">{highlighted(reply.text)}</pre>
          {reply.text.split("\n").length - 1 < reply.lines && <p class="q">The rest is in the file.</p>}
        </div>
      )}
    </section>
  );
}

const NO_COMPILER = "not compared: no C compiler found";

/** What was compiled and compared, and how far it is from the simulation. */
export function Compared({ own, compiler }: { own: ComparedCode | null; compiler: string }) {
  if (own === null)
    return (
      <span class="end q" id="compared">
        {compiler === "" ? (
          <>
            {NO_COMPILER}
            <small>install gcc or clang, or set CC</small>
          </>
        ) : (
          "not compared yet"
        )}
      </span>
    );
  const worst = own.outputs.toSorted((a, b) => relative(b) - relative(a))[0];
  const all = own.outputs.map((each) => `${each.name}: ${apart(each)}`).join("\n");
  return (
    <span class="end" id="compared" title={all}>
      <small class="good">
        <Icon name="done" /> compiled with {own.compiler} and compared
      </small>
      {counted(own.samples, "sample")},{" "}
      {own.exact || worst === undefined ? <b>equal bit for bit</b> : <b>{apart(worst)} apart at most</b>}
    </span>
  );
}

type Deviation = ComparedCode["outputs"][number];

const relative = (own: Deviation): number =>
  own.largest === null ? Infinity : own.range > 0 ? own.largest / own.range : own.largest;

const apart = (own: Deviation): string =>
  `${own.largest === null ? MISSING : significant(own.largest, 2)} ${unitText(own.unit)}`.trim();

const TOKENS =
  /(\/\*[\s\S]*?\*\/)|(^#\w+)|\b(const|static|void|double|float|bool|int|struct|typedef|return|if|else|for|while|volatile|u?int(?:8|16|32|64)_t)\b/gm;

/** C code with its comments and words marked. */
function highlighted(text: string) {
  const parts = [];
  let at = 0;
  for (const match of text.matchAll(TOKENS)) {
    parts.push(text.slice(at, match.index));
    parts.push(<span class={match[1] ? "c" : "k"}>{match[0]}</span>);
    at = match.index + match[0].length;
  }
  return [...parts, text.slice(at)];
}
