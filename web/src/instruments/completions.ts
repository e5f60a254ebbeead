// Completion of names in formula text: functions with their arguments, tables, nodes and inputs.

import {
  autocompletion,
  type Completion,
  type CompletionContext,
  type CompletionResult,
} from "@codemirror/autocomplete";
import type { Extension } from "@codemirror/state";
import { ask } from "../connection";
import type { CompletionRow } from "../replies";
import { onRenewal } from "../scope";
import { state } from "../store";

const BOOST = { node: 3, input: 2, parameter: 1, function: 0 }; // those of the project come first
let known: { revision: number; options: Promise<Completion[]> } | null = null;

onRenewal(() => {
  known = null;
});

/** The names that formula text can use; asked again once the texts have changed. */
function options(): Promise<Completion[]> {
  const revision = state.value.textRevision;
  if (known?.revision !== revision)
    known = {
      revision,
      options: ask("completions").then(
        (reply) => reply.head.completions.map(asCompletion),
        () => [],
      ),
    };
  return known.options;
}

/** A function is completed with the parenthesis of its arguments, which are shown beside it. */
const asCompletion = ({ label, kind, detail }: CompletionRow): Completion => ({
  label,
  detail: kind === "function" && detail.startsWith(label) ? detail.slice(label.length) : detail,
  type: kind,
  boost: BOOST[kind],
  apply: kind === "function" ? `${label}(` : label,
});

async function complete(context: CompletionContext): Promise<CompletionResult | null> {
  const word = context.matchBefore(/[A-Za-z_][\w.]*/);
  if (word === null && !context.explicit) return null;
  const from = word?.from ?? context.pos;
  const before = context.state.doc.lineAt(from).text.slice(0, from - context.state.doc.lineAt(from).from);
  if (before.includes("#") || before.lastIndexOf("[") > before.lastIndexOf("]")) return null; // comments and units
  if (!context.explicit && !/[=(]/.test(before)) return null; // the name of a new node
  // which may be this word alone
  const own = (await options()).filter((each) => each.type === "function" || each.label !== word?.text);
  return { from, options: own, validFor: /^[\w.]*$/ };
}

export const completions: Extension = autocompletion({ override: [complete], icons: false });
