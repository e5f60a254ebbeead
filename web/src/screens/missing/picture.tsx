// The fitted term over its channel with its standard deviation, or over both of them, and the errors without and with it.

import { drawStep, drawTerm } from "../../drawing/term";
import { Picture } from "../../instruments/picture";
import { otherPlace, proposal, shownTerm } from "../../missing";
import type { ShownTerm } from "../../replies";

export function TermPicture() {
  const [own, reply] = [proposal.value, shownTerm.value];
  if (own === null) return <section class="pane curve none" />;
  const kind = (otherPlace.value ?? own).kind;
  const head = reply?.head;
  return (
    <section class="pane curve" aria-label="Term">
      <div class="head">
        <h2 class="cut">{head?.parameter || own.change}</h2>
        <span class="sub">{subtitle(kind, head)}</span>
        <span class="right">
          {head?.fitted && kind !== "delay" && (
            <>
              <span class="key">
                <i style={{ color: "var(--model)" }} />
                {kind === "lag" ? "step response" : head.second ? "map" : "curve"}
              </span>
              {!head.second && (
                <span class="key">
                  <i class="box sigma" />± 1 σ
                </span>
              )}
            </>
          )}
        </span>
      </div>
      {reply === null ? (
        <p class="pad q">Computing</p>
      ) : kind === "lag" || kind === "delay" ? (
        <Picture
          kind="body"
          label="Step response of the term"
          of={[reply]}
          draw={(pen, width, height) => drawStep(pen, width, height, reply.head, kind, own.change)}
        />
      ) : (
        <Picture
          kind="body"
          label={`The proposed ${reply.head.second ? "map" : "curve"}, and the errors over its channel`}
          of={[reply, own]}
          draw={(pen, width, height) => drawTerm(pen, width, height, reply.head, reply.arrays, kind, own.node)}
        />
      )}
    </section>
  );
}

function subtitle(kind: string, head: ShownTerm | undefined): string {
  if (head === undefined) return "";
  if (kind === "delay") return "has no value to fit";
  if (!head.fitted) return "not fitted at this place: begins without effect";
  return "a first fit, with its standard deviation";
}
