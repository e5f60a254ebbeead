// The editor of formula text, with the parser's messages at their characters. Loaded when it is first shown: it is large.

import { defaultKeymap, history, historyKeymap, indentWithTab } from "@codemirror/commands";
import { lintGutter, setDiagnostics, type Diagnostic } from "@codemirror/lint";
import { EditorState } from "@codemirror/state";
import { EditorView, highlightActiveLine, keymap, lineNumbers } from "@codemirror/view";
import { useEffect, useRef } from "preact/hooks";
import { newest } from "../connection";
import { settings } from "../settings";
import { request, state } from "../store";

const sendText = newest(async ({ file, text }: { file: string; text: string }) => {
  await request("set-text", { file, text, title: `Edited ${file || "the project file"}`, drag: `typing ${file}` });
});

/** Edit the function, or the project file if `file` is empty. */
export function TextEditor({ file }: { file: string }) {
  const host = useRef<HTMLDivElement>(null);
  const view = useRef<EditorView | null>(null);
  useEffect(() => {
    const own = new EditorView({
      parent: host.current!,
      state: EditorState.create({
        doc: textOf(file),
        extensions: [
          lineNumbers(), history(), highlightActiveLine(), lintGutter(), keymap.of([...defaultKeymap, ...historyKeymap, indentWithTab]),
          EditorView.cspNonce.of(document.querySelector<HTMLMetaElement>("meta[name=nonce]")?.content ?? ""),
          EditorView.contentAttributes.of({ "aria-label": file ? "Formula text" : "Project file" }),
          EditorView.updateListener.of((update) => {
            if (update.docChanged && update.transactions.some((t) => t.isUserEvent("input") || t.isUserEvent("delete") || t.isUserEvent("undo") || t.isUserEvent("redo"))) sendText({ file, text: update.state.doc.toString() });
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
    if (!own.hasFocus && own.state.doc.toString() !== text) own.dispatch({ changes: { from: 0, to: own.state.doc.length, insert: text } });
    own.dispatch(setDiagnostics(own.state, diagnostics(own.state, file)));
  }, [settings.value, state.value.findings]);
  return <div class="editor" ref={host} />;
}

const textOf = (file: string): string => (file ? settings.value.function : settings.value.text.replace(/\r\n/g, "\n"));

/** The parser's messages at their characters; one without a column underlines its line. */
function diagnostics(own: EditorState, file: string): Diagnostic[] {
  const name = file || state.value.project!.path.split(/[\\/]/).at(-1);
  return state.value.findings.filter((f) => f.file === name && f.line > 0 && f.line <= own.doc.lines).map((f) => {
    const line = own.doc.line(f.line);
    const from = Math.min(line.to, line.from + Math.max(0, (f.column || 1) - 1));
    const word = /^[\w.%]+/.exec(own.doc.sliceString(from, line.to))?.[0].length ?? 1;
    return { from: f.column ? from : line.from, to: f.column ? Math.min(line.to, from + Math.max(1, word)) : line.to, severity: f.severity === "remark" ? "info" : f.severity, message: f.text };
  });
}
