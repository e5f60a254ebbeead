// What the function needs and the project lacks, each with a button that adds it.

import { effect } from "@preact/signals";
import { newest } from "../connection";
import { Icon } from "../icons";
import type { ProposalRow } from "../replies";
import { scoped } from "../scope";
import { type Change, setKeys } from "../settings";
import { request, settled } from "../store";

const proposals = scoped<ProposalRow[]>([]);
const choices = scoped<Record<string, string>>({}); // by title

const load = newest(async (_: number) => {
  const reply = await request("proposals");
  if (reply !== null) proposals.value = reply.head.proposals;
});

effect(() => {
  const { project, findings, revision } = settled.value;
  if (project !== null && findings.length > 0) load(revision);
  else proposals.value = [];
});

const complete = (own: ProposalRow): boolean =>
  own.choice === null || own.choice.options.includes(choices.value[own.title] ?? "");

function add(chosen: ProposalRow[]): void {
  const changes = chosen.flatMap<Change>((each) =>
    each.choice === null ? each.changes : [...each.changes, [each.choice.path, choices.value[each.title]!]],
  );
  void setKeys(
    changes,
    chosen.length === 1
      ? `Added: ${chosen[0]!.title} ${choices.value[chosen[0]!.title] ?? ""}`
      : `Added ${chosen.length} proposals`,
  );
}

export function Proposals() {
  const all = proposals.value;
  if (all.length === 0) return null;
  const ready = all.filter(complete);
  return (
    <div class="proposals" id="proposals">
      <div class="head mid">
        <h2>The function needs</h2>
        <span class="sub">axes from the data, rounded; slightly smooth</span>
        <span class="right">
          <button class="btn small primary" id="add-all" disabled={!ready.length} onClick={() => add(ready)}>
            {ready.length < all.length ? `Add ${ready.length}` : "Add all"}
          </button>
        </span>
      </div>
      {all.map((each) => (
        <div class="ck i">
          <Icon name="plus" />
          <span class="grow">
            {each.title}
            {each.choice && (
              <>
                {" "}
                <ChoiceOf own={each} />
              </>
            )}
          </span>
          <button class="btn small" disabled={!complete(each)} onClick={() => add([each])}>
            Add
          </button>
        </div>
      ))}
    </div>
  );
}

function ChoiceOf({ own }: { own: ProposalRow }) {
  const value = choices.value[own.title] ?? "";
  return (
    <select
      class="field small"
      aria-label={own.title}
      value={value}
      onChange={(event) => {
        choices.value = { ...choices.value, [own.title]: event.currentTarget.value };
      }}
    >
      {["", ...own.choice!.options].map((option) => (
        <option value={option}>{option || "choose"}</option>
      ))}
    </select>
  );
}
