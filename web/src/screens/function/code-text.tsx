// The source text of a function in C or Python, read-only, with its problems at their lines.

import { useEffect, useRef } from "preact/hooks";
import { Icon } from "../../icons";
import type { ProjectFunction } from "../../replies";
import { chosen } from "./source";

/** Show a line of the source text. */
export const showLine = (line: number): void => {
  chosen.value = `line ${line}`;
};

/**
 * The number of the line that defines a function, counted from 1; 0 if none is recognised. A prototype of C ends with a
 * semicolon.
 */
function definition(rows: string[], name: string): number {
  if (name === "") return 0;
  const head = new RegExp(`^\\s*(?:def\\s+|[A-Za-z_][\\w\\s*]*[\\s*])${name}\\s*\\((?!.*;\\s*$)`);
  return rows.findIndex((row) => head.test(row)) + 1;
}

export function CodeText({ own }: { own: ProjectFunction }) {
  const list = useRef<HTMLDivElement>(null);
  const rows = own.source.replace(/\s+$/, "").split("\n");
  const begin = definition(rows, own.function);
  const wrong = new Map(own.problems.filter((each) => each.line > 0).map((each) => [each.line, each.message]));
  const chosenLine = /^line (\d+)$/.exec(chosen.value)?.[1];
  const shown = chosenLine === undefined ? ([...wrong.keys()][0] ?? begin) : Number(chosenLine);
  const show = () =>
    list.current
      ?.querySelector(`[data-line="${shown}"]`)
      ?.scrollIntoView({ block: shown === begin ? "start" : "center" });
  useEffect(() => {
    show();
  }, [own.file, own.function, shown]);
  const tokens = /\.py$/i.test(own.file) ? PYTHON : C;
  return (
    <>
      <div class="head mid">
        <h2>Source text</h2>
        <span class="sub">{rows.length} lines, read-only</span>
      </div>
      <div class="code plain mono" ref={list} role="list" aria-label="Source text">
        {own.source ? (
          rows.map((text, k) => (
            <Row
              key={k}
              number={k + 1}
              text={text}
              tokens={tokens}
              lit={k + 1 === (chosenLine === undefined ? begin : shown)}
              problem={wrong.get(k + 1)}
            />
          ))
        ) : (
          <p class="pad q">The text of this file cannot be shown.</p>
        )}
      </div>
    </>
  );
}

function Row({
  number,
  text,
  tokens,
  lit,
  problem,
}: {
  number: number;
  text: string;
  tokens: RegExp;
  lit: boolean;
  problem: string | undefined;
}) {
  return (
    <div
      class={`ln ${lit ? "lit-line" : ""} ${problem ? "wrong" : ""}`}
      role="listitem"
      data-line={number}
      title={problem}
    >
      <i>{problem ? <Icon name="warning" kind="bad" /> : number}</i>
      <code>
        <Code text={text} tokens={tokens} />
      </code>
    </div>
  );
}

const C =
  /(\/\/.*$|\/\*.*?(?:\*\/|$)|^\s*\*(?!\w).*$|^\s*#.*$)|("(?:[^"\\]|\\.)*"|(?<![\w.])\d[\w.]*(?:[eE][+-]\d+)?)|(\b(?:auto|bool|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|if|inline|int|long|register|return|short|signed|sizeof|static|struct|switch|typedef|unsigned|void|volatile|while|u?int(?:8|16|32|64)_t|real(?:32)?_T|u?int(?:8|16|32)_T|boolean_T)\b)/g;
const PYTHON =
  /(#.*$)|("(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*'|(?<![\w.])\d[\w.]*(?:[eE][+-]\d+)?)|(\b(?:and|as|assert|break|class|continue|def|elif|else|except|False|finally|for|from|global|if|import|in|is|lambda|None|not|or|pass|raise|return|True|try|while|with|yield)\b)/g;

/** A line with its tokens coloured: comments, texts and numbers, words of the language. */
function Code({ text, tokens }: { text: string; tokens: RegExp }) {
  const parts: preact.ComponentChildren[] = [];
  let end = 0;
  for (const match of text.matchAll(tokens)) {
    const [whole, comment, literal] = match;
    parts.push(text.slice(end, match.index), <span class={comment ? "kc" : literal ? "kn" : "kf"}>{whole}</span>);
    end = match.index + whole.length;
  }
  return (
    <>
      {parts}
      {text.slice(end)}
    </>
  );
}
