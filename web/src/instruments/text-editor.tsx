// The editor of formula text, with the parser's messages at their characters. Loaded when it is first shown: it is
// large.

import { defaultKeymap, history, historyKeymap, indentWithTab } from "@codemirror/commands";
import { type Action, type Diagnostic, lintGutter, lintKeymap, setDiagnostics } from "@codemirror/lint";
import { EditorState } from "@codemirror/state";
import { EditorView, highlightActiveLine, keymap, lineNumbers } from "@codemirror/view";
import { useEffect, useRef } from "preact/hooks";
import { newest } from "../connection";
import { jump } from "../jump";
import type { FindingRow } from "../replies";
import { settings } from "../settings";
import { beforeCommands, request, state } from "../store";
import { completions } from "./completions";
import { split } from "./error-split";
import { formulaHighlighting } from "./formula-highlighting";
import { isUnitless, nodeOf, nodeValues, valuesChanged } from "./node-values";
import { spellings } from "./spellings";

const sendText = newest(async ({ file, text }: { file: string; text: string }) => {
  await request("set-text", { file, text, title: `Edited ${file || "the project file"}`, drag: `typing ${file}` });
});

beforeCommands(sendText.flush);

const isNumbered = (text: string): boolean => /^\s*1\s+\S/.test(text);

/** A column of numbers or of units that is empty takes no room. */
const attributesOf = (text: string): Record<string, string> => ({
  class: `${isNumbered(text) ? "own-numbers" : ""} ${text.split("\n").every(isUnitless) ? "unitless" : ""}`,
});

/** Edit the function, or the project file if `file` is empty; `choose` is told the node of the line with the cursor. */
export function TextEditor({ file, choose }: { file: string; choose?: (node: string) => void }) {
  const host = useRef<HTMLDivElement>(null);
  const view = useRef<EditorView | null>(null);
  useEffect(() => {
    const own = new EditorView({
      parent: host.current!,
      state: EditorState.create({
        doc: textOf(file),
        extensions: [
          // lines that carry numbers themselves need no others
          lineNumbers({ formatNumber: (line, state) => (isNumbered(state.doc.line(1).text) ? "" : String(line)) }),
          history(),
          EditorView.editorAttributes.of((own) => attributesOf(own.state.doc.toString())),
          highlightActiveLine(),
          lintGutter(),
          keymap.of([...lintKeymap, ...defaultKeymap, ...historyKeymap, indentWithTab]),
          ...(file ? [nodeValues, formulaHighlighting, completions, EditorView.lineWrapping] : []),
          EditorView.cspNonce.of(document.querySelector<HTMLMetaElement>("meta[name=nonce]")?.content ?? ""),
          EditorView.contentAttributes.of({ "aria-label": file ? "Formula text" : "Project file" }),
          EditorView.updateListener.of((update) => {
            if (update.selectionSet && update.view.hasFocus)
              choose?.(nodeOf(update.state.doc.lineAt(update.state.selection.main.head).text));
            if (
              update.docChanged &&
              update.transactions.some(
                (t) =>
                  t.isUserEvent("input") || t.isUserEvent("delete") || t.isUserEvent("undo") || t.isUserEvent("redo"),
              )
            )
              sendText({ file, text: update.state.doc.toString() });
          }),
        ],
      }),
    });
    view.current = own;
    return () => own.destroy();
  }, []);
  useEffect(() => {
    const own = view.current!;
    const text = textOf(file);
    if (!own.hasFocus && own.state.doc.toString() !== text)
      own.dispatch({ changes: { from: 0, to: own.state.doc.length, insert: text } });
    own.dispatch(setDiagnostics(own.state, diagnostics(own.state, file)));
  }, [settings.value, state.value.findings, spellings.value]);
  useEffect(() => {
    view.current!.dispatch({ effects: valuesChanged });
  }, [split.value]);
  useEffect(() => {
    goTo(view.current!, file);
  }, [jump.value]);
  return <div class="editor" ref={host} />;
}

/** Go to the place `jump` if it is in this file. */
function goTo(own: EditorView, file: string): void {
  const place = jump.peek();
  if (place === null || place.file !== nameOf(file)) return;
  jump.value = null;
  const line = own.state.doc.line(Math.max(1, Math.min(place.line, own.state.doc.lines)));
  own.dispatch({
    selection: { anchor: Math.min(line.to, line.from + Math.max(0, place.column - 1)) },
    scrollIntoView: true,
  });
  own.focus();
}

/** The name under which messages know a file. */
const nameOf = (file: string): string | undefined => file || state.value.project!.path.split(/[\\/]/).at(-1);

const textOf = (file: string): string => (file ? settings.value.function : settings.value.text.replace(/\r\n/g, "\n"));

/** The known name that can replace a misspelt one. */
function actions(finding: FindingRow): Action[] {
  return spellings.value
    .filter((each) => each.line === finding.line && each.column === finding.column)
    .map((each) => ({
      name: `Use ${each.similar}`,
      apply: (view, from, to) => view.dispatch({ changes: { from, to, insert: each.similar }, userEvent: "input" }),
    }));
}

/** The parser's messages at their characters; one without a column underlines its line. */
function diagnostics(own: EditorState, file: string): Diagnostic[] {
  const name = nameOf(file);
  return state.value.findings
    .filter((f) => f.file === name && f.line > 0 && f.line <= own.doc.lines)
    .map((f) => {
      const line = own.doc.line(f.line);
      const from = Math.min(line.to, line.from + Math.max(0, (f.column || 1) - 1));
      const word = /^[\w.%]+/.exec(own.doc.sliceString(from, line.to))?.[0].length ?? 1;
      return {
        from: f.column ? from : line.from,
        to: f.column ? Math.min(line.to, from + Math.max(1, word)) : line.to,
        severity: f.severity === "remark" ? "info" : f.severity,
        message: f.text,
        actions: actions(f),
      };
    });
}
