// What to measure next: the question, deviations now and as predicted, and the list of what to drive or to measure.

import { computing, designs, propose, step } from "../design";
import { Footer, Key } from "../frame";
import { useScreenKeys } from "../screen-keys";
import { request, state } from "../store";
import { AskPane } from "./design/ask";
import { ListPane, OpenPane } from "./design/list";
import { MapsPane } from "./design/maps";
import "../instruments/search-panes.css";
import "./design.css";

function takeKey(event: KeyboardEvent, typing: boolean): boolean {
  if (event.key === "Escape" && computing.value) void request("stop-design");
  else if (typing) return false;
  else if (event.key === "ArrowDown" || event.key === "ArrowUp") step(event.key === "ArrowDown" ? 1 : -1);
  else if (event.key === "p") void propose();
  else return false;
  return true;
}

export function DesignScreen() {
  useScreenKeys(takeKey);
  return (
    <>
      <main class="design">
        {state.value.project === null || designs.value === null ? (
          <section class="pane all">
            <div class="head">
              <h2>Measure next</h2>
            </div>
            <p class="pad q" id="design-empty">
              {state.value.project === null
                ? "Open a project first: drives and points that would determine its values are proposed here."
                : "Reading what the data determine"}
            </p>
          </section>
        ) : (
          <>
            <AskPane own={designs.value} />
            <MapsPane />
            <ListPane />
            <OpenPane />
          </>
        )}
      </main>
      <Footer>
        <span>deviations are predictions from the sensitivities, not from measured values</span>
        <Key keys={["↑", "↓"]} text="segment" />
        <Key keys={["p"]} text="propose" />
        <Key keys={["Alt", "9"]} text="this screen" />
      </Footer>
    </>
  );
}
