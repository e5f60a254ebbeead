// Which term the function lacks: what is looked for, the proposals, and the chosen one with its place, curve and change.

import { counted } from "../drawing/numbers";
import { Footer, Key } from "../frame";
import { apply, look, looking, outcome, step, terms } from "../missing";
import { useScreenKeys } from "../screen-keys";
import { blocking, request, state } from "../store";
import { ChangePane } from "./missing/change";
import { LookFor } from "./missing/look-for";
import { TermPicture } from "./missing/picture";
import { HeldOutPane, ProposalsPane, Verdict } from "./missing/proposals";
import { WherePane } from "./missing/where";
import "../instruments/search-panes.css";
import "./missing.css";

function takeKey(event: KeyboardEvent, typing: boolean): boolean {
  const onButton = (event.target as HTMLElement).closest("button, [role=button], summary") !== null; // takes Enter itself
  if (event.key === "Escape" && looking.value) void request("stop-looking");
  else if (typing) return false;
  else if (event.key === "ArrowDown" || event.key === "ArrowUp") step(event.key === "ArrowDown" ? 1 : -1);
  else if (event.key === "l") void look();
  else if (event.key === "Enter" && !onButton) void apply();
  else return false;
  return true;
}

export function MissingScreen() {
  useScreenKeys(takeKey);
  const empty = state.value.parameters.length === 0 || state.value.criteria.length === 0;
  return (
    <>
      <main class="missing">
        {empty || terms.value === null ? (
          <section class="pane all">
            <div class="head">
              <h2>What is missing?</h2>
            </div>
            <p class="pad q" id="missing-empty">
              {emptyText(empty)}
            </p>
          </section>
        ) : (
          <>
            <LookFor own={terms.value} />
            <div class="mid">
              <ProposalsPane />
              <HeldOutPane />
              <Verdict />
            </div>
            <div class="rt">
              <WherePane />
              <TermPicture />
              <ChangePane />
            </div>
          </>
        )}
      </main>
      <Footer>
        {outcome.value !== null && (
          <span>
            {counted(outcome.value.candidates, "candidate")} in {outcome.value.seconds.toFixed(1)} s
          </span>
        )}
        <Key keys={["↑", "↓"]} text="proposal" />
        <Key keys={["l"]} text="look" />
        <Key keys={["Enter"]} text="apply" />
        <Key keys={["Ctrl", "Z"]} text="undo" />
      </Footer>
    </>
  );
}

function emptyText(empty: boolean): string {
  if (state.value.project === null) return "Open a project first: terms that its function lacks are proposed here.";
  if (!empty) return "Reading the channels of the recordings";
  const reason = blocking.value === null ? "" : ` It cannot yet: ${blocking.value.text}`;
  return `Terms that the function lacks are proposed here, once the project can be evaluated.${reason}`;
}
