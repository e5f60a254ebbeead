// The change of the formula and of the project file, and the buttons that apply it.

import { counted } from "../../drawing/numbers";
import { apply, otherPlace, place, proposal, shownTerm, unapplied } from "../../missing";
import type { ChangedFile } from "../../replies";
import { run } from "../../runs";
import { scoped } from "../../scope";
import { message, screen, state } from "../../store";

const shownFile = scoped(0);

export function ChangePane() {
  const [own, head] = [proposal.value, shownTerm.value?.head];
  if (own === null || head === undefined) return <section class="pane df none" />;
  const file = head.files[shownFile.value] ?? head.files[0];
  const written = head.reason === "";
  if (head.files.length === 0) return <Buttons values={own.values} />;
  return (
    <>
      <section class="pane df" aria-label="Change">
        <div class="head">
          {head.files.map((each, k) => (
            <button class="link file" aria-pressed={each === file} onClick={() => (shownFile.value = k)}>
              {each.file}
            </button>
          ))}
          <span class="sub">{written ? "the change" : "what the project file gets"}</span>
          <span class="right">
            {file && (
              <button class="btn small" onClick={() => void copy(file)}>
                Copy
              </button>
            )}
          </span>
        </div>
        {!written && (
          <div class="note warn" id="not-written">
            <span class="grow">
              <code>{head.text}</code>
              <br />
              {head.reason}. Add the term where the function was made
              {state.value.function.screen === "formula" ? "." : ", or edit the function as formula text."}
            </span>
            <button
              class="btn small"
              onClick={() => {
                screen.value = "function";
              }}
            >
              Function
            </button>
          </div>
        )}
        <div class="src" id="term-change">
          {file?.lines.map((line) => (
            <span class={{ "+": "add", "-": "del" }[line.sign] ?? "ctx"}>
              {`${line.line ? String(line.line).padStart(3) : "   "} ${line.sign === "-" ? "−" : line.sign} ${line.text}`}
            </span>
          ))}
        </div>
      </section>
      <Buttons values={own.values} />
    </>
  );
}

function Buttons({ values }: { values: number }) {
  const reason = unapplied.value;
  const more = `${values === 0 ? "no value" : counted(values, "value")} more`;
  return (
    <div class="frow" id="apply-row">
      <button
        class="btn primary"
        id="apply-term"
        disabled={reason !== ""}
        title={reason || "Write the term into the formula and the project (Enter)"}
        onClick={() => void apply()}
      >
        Apply
      </button>
      <button
        class="btn"
        id="apply-run"
        disabled={reason !== ""}
        title={reason || "Write the term, and fit all values with it"}
        onClick={async () => {
          if (await apply()) run();
        }}
      >
        Apply and run
      </button>
      <span class={`cut grow ${reason ? "warn" : "q"}`} title={reason}>
        {reason ||
          `${more}; one undo${place.value === null ? "" : `; ${otherPlace.value?.node} is fitted by the next run`}`}
      </span>
    </div>
  );
}

async function copy(file: ChangedFile): Promise<void> {
  const text = file.lines.map((line) => `${line.sign} ${line.text}`).join("\n");
  await navigator.clipboard.writeText(text);
  message.value = `Copied the change of ${file.file}`;
}
