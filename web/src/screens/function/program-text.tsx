// The source text of an ASCET model, a file at a time, with the values at the cursor beside the variables that it
// declares.

import { computed, effect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { numberText } from "../../drawing/numbers";
import { Icon } from "../../icons";
import { split, useSplit } from "../../instruments/error-split";
import type { NodeValue } from "../../replies";
import { scoped } from "../../scope";
import { open, screen, state } from "../../store";
import { chosen, program } from "./source";

const file = scoped(0); // number of the file that is shown

effect(() => {
  void program.value?.file;
  file.value = 0;
});

/** Show a place in the source, as `file:line`. */
export function showPlace(place: string): void {
  const [source, line] = place.split(":").map(Number);
  if (source! < 0) return;
  file.value = source!;
  chosen.value = `${source}:${line}`;
}

const sources = computed(() => program.value?.sources ?? []);
const source = computed(() => sources.value[file.value] ?? sources.value[0]);

/** Names that are declared in the lines of the file that is shown. */
const declared = computed(() => {
  const lines = new Map<number, string[]>();
  for (const place of program.value?.places ?? [])
    if (place.source === file.value) lines.set(place.line, [...(lines.get(place.line) ?? []), place.name]);
  return lines;
});

export function ProgramText() {
  useSplit();
  const list = useRef<HTMLDivElement>(null);
  const own = program.value;
  useEffect(() => {
    list.current?.querySelector(".lit-line")?.scrollIntoView({ block: "nearest" });
  }, [chosen.value, own, file.value]);
  if (own === null) return <p class="pad q">Reading the model</p>;
  const values = new Map((split.value?.nodes ?? []).map((node) => [node.name, node]));
  const parameters = new Set(state.value.parameters.map((each) => each.name));
  const wrong = new Map(
    own.problems.filter((each) => each.source === file.value && each.line > 0).map((each) => [each.line, each]),
  );
  const rows = (source.value?.text ?? "").replace(/\s+$/, "").split("\n");
  return (
    <>
      <div class="filter">
        <select
          class="field grow"
          aria-label="Source file"
          title="Files of the classes and data interfaces that take part"
          value={file.value}
          onChange={(event) => {
            file.value = Number(event.currentTarget.value);
          }}
        >
          {sources.value.map((each, k) => (
            <option value={k}>
              {each.file}
              {own.problems.some((problem) => problem.source === k) ? " (!)" : ""}
            </option>
          ))}
        </select>
        <span class="q">{sources.value.length === 1 ? "1 file" : `${sources.value.length} files`}, read-only</span>
      </div>
      <div class="ln hd">
        <i />
        <code>ESDL</code>
        <span class="num">start</span>
        <span class="num">now</span>
      </div>
      <div class="code mono" ref={list} role="list" aria-label="Source text">
        {source.value?.text ? (
          rows.map((text, k) => (
            <Row
              key={k}
              number={k + 1}
              text={text}
              names={declared.value.get(k + 1) ?? []}
              values={values}
              parameters={parameters}
              problem={wrong.get(k + 1)?.message}
            />
          ))
        ) : (
          <p class="pad q">
            {sources.value.length === 0 ? "No file can be read." : "The text of this file cannot be shown."}
          </p>
        )}
      </div>
    </>
  );
}

interface RowProps {
  number: number;
  text: string;
  names: string[];
  values: Map<string, NodeValue>;
  parameters: Set<string>;
  problem: string | undefined;
}

/** A line with the value of the variable that it declares; of several variables, as in several instances, the first. */
function Row({ number, text, names, values, parameters, problem }: RowProps) {
  const place = `${file.value}:${number}`;
  const value = names.map((name) => values.get(name)).find((each) => each !== undefined);
  const parameter = names.find((name) => parameters.has(name));
  const title = [
    problem,
    ...names.slice(0, 12).map((name) => {
      const own = values.get(name);
      return own ? `${name} = ${numberText(own.now)} ${own.unit}` : name;
    }),
  ]
    .filter(Boolean)
    .join("\n");
  return (
    <div
      class={`ln ${chosen.value === place ? "lit-line" : ""} ${problem ? "wrong" : ""}`}
      role="listitem"
      data-line={number}
      title={title || undefined}
      onClick={() => {
        chosen.value = place;
      }}
    >
      <i>{problem ? <Icon name="warning" kind="bad" /> : number}</i>
      <code>
        <Esdl text={text} />
      </code>
      {parameter ? (
        <button
          class="link cut declared"
          title={`Open ${parameter}`}
          onClick={(event) => {
            event.stopPropagation();
            open(parameter);
            screen.value = "parameters";
          }}
        >
          open{names.length > 1 ? ` +${names.length - 1}` : ""}
        </button>
      ) : (
        <>
          <span class="num q">{value && numberText(value.start)}</span>
          <span class="num ink">{value && numberText(value.now)}</span>
        </>
      )}
    </div>
  );
}

const TOKEN =
  /(\/\/.*$|\/\*.*?(?:\*\/|$)|^\s*\*.*$)|("[^"]*")|((?<![\w.])\d[\d_]*\.?\d*(?:[eE][+-]?\d+)?)|(@\w+)|(\b(?:package|import|class|singleton|static|stateless|public|private|protected|data|interface|reads|writes|characteristic|const|sysconst|real|integer|boolean|type|is|table|enum|void|in|out|inout|if|then|else|switch|case|default|for|while|do|return|break|statemachine|state|junction|transition|to|start|entry|exit|triggers|using|initializer|application|schedule|startup|shutdown|task|priority|period|delay|process)\b)/g;

/** ESDL with its tokens coloured: comments, texts, numbers and words of the language. */
function Esdl({ text }: { text: string }) {
  const parts: preact.ComponentChildren[] = [];
  let end = 0;
  for (const match of text.matchAll(TOKEN)) {
    const [whole, comment, quoted, number] = match;
    parts.push(
      text.slice(end, match.index),
      <span class={comment ? "kc" : quoted || number ? "kn" : "kf"}>{whole}</span>,
    );
    end = match.index + whole.length;
  }
  return (
    <>
      {parts}
      {text.slice(end)}
    </>
  );
}
