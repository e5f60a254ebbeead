// What is looked for: kinds of terms, channels, nodes, and the least effect; the button that looks, and stops.

import type { ComponentChildren } from "preact";
import { count, counted, unitText } from "../../drawing/numbers";
import { Icon } from "../../icons";
import { NumberInput } from "../../inputs";
import { flip, hindrance, least, look, looking, omitted, outcome } from "../../missing";
import type { MissingTerms, TermKind } from "../../replies";
import { blocking, failure, request, state } from "../../store";

const KINDS: Record<TermKind["name"], string> = {
  add: "add a curve",
  multiply: "scale by a curve",
  map: "add a map of two",
  lag: "lag, PT1",
  offset: "offset by recording",
  delay: "dead time",
};

/** What the data lack for a kind of terms, in short and as a sentence. */
const lack = (kind: TermKind["name"]): [string, string] =>
  kind === "offset"
    ? ["no recordings", "an offset by recording needs 3 to 60 recordings in memory"]
    : ["no time", "the training data have no time"];

export function LookFor({ own }: { own: MissingTerms }) {
  const excluded = new Map(outcome.value?.excluded ?? []);
  const channels = own.channels.toSorted((a, b) => Number(a.reason !== "") - Number(b.reason !== ""));
  return (
    <section class="pane left" aria-label="Look for">
      <div class="head">
        <h2>Look for</h2>
      </div>
      <div class="look">
        <Group title="kinds of term">
          {own.kinds.map((kind) => (
            <Tick
              list="kinds"
              name={kind.name}
              title={KINDS[kind.name]}
              note={kind.places ? counted(kind.places, "place") : lack(kind.name)[0]}
              reason={kind.places ? undefined : lack(kind.name)[1]}
              off={kind.places === 0}
            />
          ))}
        </Group>
        <Group title="channels">
          {channels.map((channel) => (
            <Tick
              list="channels"
              name={channel.name}
              title={channel.name}
              note={channel.reason || (excluded.has(channel.name) ? "excluded" : unitText(channel.unit))}
              reason={channel.reason || excluded.get(channel.name)}
              off={channel.reason !== ""}
            />
          ))}
        </Group>
        <details class="grp">
          <summary>
            <h3>
              places <span class="n">{counted(own.nodes.length - omitted.nodes.value.size, "node")}</span>
            </h3>
          </summary>
          {own.nodes.map((name) => (
            <Tick list="nodes" name={name} title={name} note="" />
          ))}
        </details>
        <Group title="judged on">
          <div class="kv">
            <span>held out</span>
            <div class="q">{outcome.value?.proposals[0]?.heldName ?? "files, or blocks of them"}</div>
            <span>at least</span>
            <div title="What a proposal must explain on data that were held out: the root of the difference of the squared errors">
              <span class="field small num" style={{ width: "74px" }}>
                <NumberInput
                  label="At least"
                  own={least.value}
                  enter={(value) => {
                    if (value === null) least.value = 0;
                    else if (typeof value === "number" && value >= 0) least.value = value;
                    else failure.value = `The least effect must be a number >= 0, got '${value}'`;
                  }}
                />
                <u>{unitText(own.unit)}</u>
              </span>
            </div>
          </div>
        </Group>
      </div>
      <Foot />
    </section>
  );
}

function Group({ title, children }: { title: string; children: ComponentChildren }) {
  return (
    <div class="grp" role="group" aria-label={title}>
      <h3>{title}</h3>
      {children}
    </div>
  );
}

function Tick(props: {
  list: keyof typeof omitted;
  name: string;
  title: string;
  note: string;
  reason?: string;
  off?: boolean;
}) {
  const off = props.off ?? false;
  const on = !off && !omitted[props.list].value.has(props.name);
  return (
    <label
      class={`tk ${on ? "" : "no"}`}
      title={props.reason ? `${props.title} takes no part: ${props.reason}` : props.title}
    >
      <input
        type="checkbox"
        data-take={`${props.list}.${props.name}`}
        checked={on}
        disabled={off}
        onChange={() => flip(props.list, props.name)}
      />
      <span class="cut">{props.title}</span>
      <span class={`n cut ${props.reason ? "warn" : ""}`}>{props.note}</span>
    </label>
  );
}

function Foot() {
  const { text, done, parts, seconds, state: own } = state.value.terms;
  const again = outcome.value !== null;
  if (looking.value)
    return (
      <div class="frow g busy">
        <button
          class="btn stop"
          id="stop-looking"
          title="Keeps what was found (Esc)"
          onClick={() => request("stop-looking")}
        >
          <Icon name="stop" />
          Stop
        </button>
        <span class="grow">
          <span class="acc cut" id="looking" title={text}>
            {parts ? `${count(done)} of ${count(parts)}${remaining(done, parts, seconds)}` : text}
          </span>
          <progress max={parts || undefined} value={parts ? done : undefined} aria-label="Progress" />
        </span>
      </div>
    );
  const reason = blocking.value?.text ?? hindrance.value;
  return (
    <div class="frow g">
      <button
        class="btn primary"
        id="look"
        disabled={reason !== ""}
        title={reason || "Score all candidates, fit the best; nothing is changed (l)"}
        onClick={() => void look()}
      >
        <Icon name="find" />
        {again ? "Look again" : "Look"}
      </button>
      <span class={`q cut ${own === "failed" ? "bad" : ""}`} title={text}>
        {own === "failed" ? text : again ? `${outcome.value!.seconds.toFixed(1)} s` : ""}
      </span>
    </div>
  );
}

const remaining = (done: number, parts: number, seconds: number): string =>
  done > 0 ? `, ${Math.max(1, Math.round((seconds / done) * (parts - done)))} s left` : "";
