// Colours of formula text in the editor: comments, declarations, numbers, tables, functions, and the names that lines
// define.

import type { Extension } from "@codemirror/state";
import {
  Decoration,
  type DecorationSet,
  type EditorView,
  MatchDecorator,
  ViewPlugin,
  type ViewUpdate,
} from "@codemirror/view";
import { state } from "../store";

const TOKEN =
  /(#.*)|((?<=^\s*)(?:input|output|scalar|curve|map|cube|rbf|step|solver|def)(?=\s+[\w%.]))|(%(?:[^%\n]|%%)*%)|((?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?)|(\[[^\]\n]*\])|([A-Za-z_][\w.]*)(?=\s*\()|([A-Za-z_][\w.]*)(?=\s*(?:\[[^\]]*\])?\s*=[^=])|([A-Za-z_][\w.]*)/gm;
const MARKS = Object.fromEntries(
  ["kc", "kn", "kp", "kf", "kd", "q"].map((name) => [name, Decoration.mark({ class: name })]),
);

function kindOf([, comment, declaration, quoted, number, unit, call, defined, name]: RegExpExecArray): string {
  if (comment) return "kc";
  if (declaration) return "q";
  if (number) return "kn";
  if (unit) return "q";
  if (defined) return "kd";
  const known = state.value.parameters.some((each) => each.name === (quoted?.slice(1, -1) ?? call ?? name));
  return known ? "kp" : call ? "kf" : "";
}

const matcher = new MatchDecorator({
  regexp: TOKEN,
  decorate: (add, from, to, match) => {
    const mark = MARKS[kindOf(match)];
    if (mark) add(from, to, mark);
  },
});

/** Colour formula text. */
export const formulaHighlighting: Extension = ViewPlugin.fromClass(
  class {
    decorations: DecorationSet;
    constructor(view: EditorView) {
      this.decorations = matcher.createDeco(view);
    }
    update(update: ViewUpdate): void {
      this.decorations = matcher.updateDeco(update, this.decorations);
    }
  },
  { decorations: (plugin) => plugin.decorations },
);
