// What the function needs and the project lacks, each with a button that adds it.

import { computed, effect } from "@preact/signals";
import { newest } from "../connection";
import { counted, significant } from "../drawing/numbers";
import { Icon } from "../icons";
import type { ProposalRow } from "../replies";
import { scoped } from "../scope";
import { message, request, type Screen, screen, settled, state } from "../store";

export const proposals = scoped<ProposalRow[]>([]);
const problems = scoped<string[]>([]);
const choices = scoped<Record<string, string>>({}); // by title

const load = newest(async (_: number) => {
  const reply = await request("proposals");
  if (reply === null) return;
  proposals.value = reply.head.proposals;
  problems.value = reply.head.problems;
});

/** The texts that proposals are about, as long as something is missing in them; they do not depend on values. */
const incomplete = computed(() => {
  const { project, findings, textRevision } = settled.value;
  return project !== null && findings.length > 0 ? textRevision : 0;
});

effect(() => {
  if (incomplete.value > 0) load(incomplete.value);
  else proposals.value = problems.value = [];
});

const complete = (own: ProposalRow): boolean =>
  own.choice === null || own.choice.options.includes(choices.value[own.title] ?? "");

const adding = scoped(false);

/** Add proposals; the server tries them out, and says what comes of it. */
async function add(chosen: ProposalRow[]): Promise<void> {
  adding.value = true;
  message.value = "Trying out where the function looks its tables up";
  const titles = chosen.map((each) => each.title);
  const reply = await request("add-proposals", { titles, choices: choices.value });
  adding.value = false;
  if (reply === null) return;
  const { rmse, unit, problems } = reply.head;
  const what = chosen.length === 1 ? chosen[0]!.title : `${chosen.length} proposals`;
  message.value =
    rmse !== null ? `Added ${what}: RMSE ${significant(rmse)} ${unit}` : `Added ${what}. ${problems[0] ?? ""}`;
}

export function Proposals() {
  const all = proposals.value;
  if (all.length === 0) return null;
  const open = all.filter((each) => !complete(each));
  return (
    <div class="proposals" id="proposals">
      <div class="head mid">
        <h2>The function needs</h2>
        <span class="sub">axes from the data, rounded; starts and smoothness from a trial</span>
        <span class="right">
          {open.length > 0 && (
            <span class="warn">{open.length === 1 ? "one choice is open" : `${open.length} choices are open`}</span>
          )}
          <button
            class="btn small primary"
            id="add-all"
            disabled={open.length > 0 || adding.value}
            title={open.map((each) => each.title).join("\n")}
            onClick={() => void add(all)}
          >
            {adding.value ? "Trying them out" : "Add all"}
          </button>
        </span>
      </div>
      {problems.value.map((text) => (
        <p class="note bad">{text}</p>
      ))}
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
          <button class="btn small" disabled={!complete(each) || adding.value} onClick={() => void add([each])}>
            Add
          </button>
        </div>
      ))}
    </div>
  );
}

/** The screen that lists them: that of the data, unless the function is text. */
const proposalsScreen = computed<Screen>(() => (state.value.function.screen === "formula" ? "function" : "data"));

/** Adds all proposals where they are not listed; if one of them is open to choose, shows the list. */
export function AddProposals() {
  const all = proposals.value;
  if (all.length === 0 || screen.value === "data" || screen.value === proposalsScreen.value) return null;
  const open = all.filter((each) => !complete(each));
  const title = counted(all.length, "proposal");
  return (
    <button
      class="btn small"
      id="add-proposals"
      disabled={adding.value}
      title={all.map((each) => each.title).join("\n")}
      onClick={() => {
        if (open.length === 0) void add(all);
        else screen.value = proposalsScreen.value;
      }}
    >
      {adding.value ? "Trying them out" : open.length === 0 ? `Add ${title}` : title}
    </button>
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
