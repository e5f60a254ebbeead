// What lies over the page: the command palette, the list of keys, and notices that ask for a decision.

import { useComputed, useSignal } from "@preact/signals";
import { ActivityNote } from "./activity";
import { CodeConsent } from "./code-consent";
import { COMMANDS, type Command, overlay, searchable } from "./commands";
import { CopyMenu } from "./copy-menu";
import { Dialog } from "./dialog";
import { ErrorList } from "./errors";
import { HoverTip } from "./hover-tip";
import { Icon } from "./icons";
import { Fixes } from "./instruments/finding";
import { AddProposals } from "./instruments/proposals";
import { showFinding } from "./navigation";
import { decide, leaving } from "./projects";
import { foreign } from "./restart";
import { conflicts, save, takeDisk } from "./saving";
import { blocking, connected, request, screen, state } from "./store";

export function Overlays() {
  return (
    <>
      <Notices />
      <CopyMenu />
      <HoverTip />
      <Conflicts />
      <Leaving />
      {overlay.value === "palette" && <Palette />}
      {overlay.value === "keys" && <Keys />}
      {overlay.value === "errors" && <ErrorList />}
    </>
  );
}

const closeOverlay = (): void => {
  overlay.value = "";
};

function Palette() {
  const text = useSignal("");
  const chosen = useSignal(0);
  const found = useComputed(() => rank(searchable(), text.value.toLowerCase().split(/\s+/).filter(Boolean)));
  // keys may come faster than the list is drawn: what runs belongs to the text as it is, not to the list as it was
  const run = (index: number) => {
    const command = found.value[index];
    overlay.value = "";
    queueMicrotask(() => command?.run()); // once the dialog is closed: a command may put the cursor into a field
  };
  const key = (event: KeyboardEvent) => {
    if (event.key === "ArrowDown") chosen.value = Math.min(found.value.length - 1, chosen.value + 1);
    else if (event.key === "ArrowUp") chosen.value = Math.max(0, chosen.value - 1);
    else if (event.key === "Enter") run(chosen.value);
    else return;
    event.preventDefault();
  };
  return (
    <Dialog label="Find or do" kind="palette" close={closeOverlay}>
      <label class="field big">
        <Icon name="find" kind="q" />
        <input
          data-first
          aria-label="Command or parameter"
          placeholder="Find a parameter or a setting, or do something"
          value={text.value}
          onInput={(event) => {
            text.value = event.currentTarget.value;
            chosen.value = 0;
          }}
          onKeyDown={key}
        />
      </label>
      <div role="listbox" aria-label="What is found">
        {found.value.map((command, k) => (
          <button
            class={`entry ${k === chosen.value ? "on" : ""}`}
            role="option"
            aria-selected={k === chosen.value}
            onMouseEnter={() => {
              chosen.value = k;
            }}
            onClick={() => run(k)}
          >
            <span>{command.title}</span>
            {command.hint && <span class="q cut hint">{command.hint}</span>}
            <span>
              {command.keys.map((each) => (
                <kbd>{each}</kbd>
              ))}
            </span>
          </button>
        ))}
      </div>
      {found.value.length === 0 && <p class="pad q">Nothing has this name.</p>}
    </Dialog>
  );
}

/** Those whose title has all words come first, then those whose help has. */
function rank(all: Command[], words: string[]): Command[] {
  const has = (text: string) => words.every((word) => text.toLowerCase().includes(word));
  const inTitle = all.filter((command) => has(command.title));
  return [
    ...inTitle,
    ...all.filter((command) => !inTitle.includes(command) && has(`${command.title} ${command.hint ?? ""}`)),
  ].slice(0, 12);
}

const GROUPS: [string, [string[], string][]][] = [
  [
    "Table",
    [
      [["←", "→", "↑", "↓"], "move"],
      [["Shift", "arrows"], "select"],
      [["Enter"], "set all selected"],
      [["+", "−"], "small step, with Shift a large one"],
      [["=", "*", "/"], "arithmetic: *1,1"],
      [["i"], "interpolate"],
      [["s"], "smooth"],
      [["l"], "lock or free"],
      [["p"], "pin, or remove the pin"],
      [["e"], "evidence: its samples in Plots"],
      [["d"], "values, or the difference to the reference"],
      [["g"], "grey reference"],
      [["h"], "hatch values without data"],
      [["Del"], "back to the reference"],
      [["Ctrl", "C"], "copy, and Ctrl V paste, as in Excel"],
    ],
  ],
  [
    "Plots",
    [
      [["Z"], "zoom by dragging"],
      [["R"], "measure a range"],
      [["B"], "brush: light up samples everywhere; Shift+drag always does"],
      [["F"], "fit the time axis to what is brushed or measured"],
      [["W"], "whole recording"],
      [["Backspace"], "back"],
      [["←", "→"], "cursor by a sample, with Shift ten"],
      [["Home", "End"], "first, last sample"],
      [["↑", "↓"], "closer, wider"],
      [["Page ↑", "Page ↓"], "move the stretch"],
      [["S"], "search signals"],
      [["M"], "strips or scatter matrix"],
      [["Esc"], "no selection"],
    ],
  ],
  [
    "Strips",
    [
      [["Enter"], "add the signal as a strip"],
      [["Shift", "Enter"], "add it to the active strip"],
      [["Alt", "↑"], "move a strip up, Alt ↓ down"],
      [["+", "−"], "higher, lower"],
      [["Del"], "remove"],
    ],
  ],
  [
    "Surface",
    [
      [["drag"], "a point up or down; the ground turns"],
      [["double click"], "home"],
    ],
  ],
];

function Keys() {
  return (
    <Dialog label="Keys" kind="keys" close={closeOverlay}>
      <div class="head">
        <h2>Keys</h2>
        <span class="right">
          <button class="btn bare small" data-first onClick={closeOverlay}>
            Close
          </button>
        </span>
      </div>
      <div class="columns">
        <section>
          <h3>Everywhere</h3>
          {COMMANDS.filter((c) => c.keys.length).map((c) => (
            <p>
              {c.keys.map((each) => (
                <kbd>{each}</kbd>
              ))}{" "}
              <span>{c.title}</span>
            </p>
          ))}
          <p>
            <kbd>Ctrl</kbd>
            <kbd>K</kbd> <span>Find or do</span>
          </p>
        </section>
        {GROUPS.map(([title, rows]) => (
          <section>
            <h3>{title}</h3>
            {rows.map(([keys, text]) => (
              <p>
                {keys.map((each) => (
                  <kbd>{each}</kbd>
                ))}{" "}
                <span>{text}</span>
              </p>
            ))}
          </section>
        ))}
      </div>
    </Dialog>
  );
}

/** What becomes of the unsaved edits when another project is opened in this page. */
function Leaving() {
  if (leaving.value === null) return null;
  const { project, unsaved } = state.value;
  const cancel = (): void => {
    leaving.value = null;
  };
  return (
    <Dialog label="Unsaved changes" kind="leaving" close={cancel}>
      <div class="head">
        <h2>
          {project?.name} has {unsaved.length} unsaved change{unsaved.length === 1 ? "" : "s"}
        </h2>
      </div>
      <div class="pad">
        <ul class="titles">
          {unsaved.slice(-6).map((title, k) => (
            <li key={k} class="cut">
              {title}
            </li>
          ))}
        </ul>
        <p class="q">
          Kept changes stay open in Kennfeld, with Undo, until it ends; after that they are offered again.
        </p>
        <div class="go">
          <button class="btn primary" id="leave-save" data-first onClick={() => decide("save")}>
            Save and open
          </button>
          <button class="btn" id="leave-keep" onClick={() => decide("keep")}>
            Keep them unsaved
          </button>
          <button class="btn" id="leave-discard" onClick={() => decide("discard")}>
            Discard them
          </button>
          <button class="btn bare" onClick={cancel}>
            Cancel
          </button>
        </div>
      </div>
    </Dialog>
  );
}

/** What keeps the project from being evaluated, on every screen, with what solves it. */
function Blocking() {
  const own = blocking.value;
  // what is not allowed yet is asked for by a notice of its own
  if (own === null || state.value.code.length > 0 || state.value.interrupted || screen.value === "start") return null;
  const more = state.value.findings.filter((each) => each.severity === "error").length - 1;
  return (
    <div class="note bad" id="blocking">
      <Icon name="warning" />
      <span class="grow cut" title={own.text}>
        {own.text}
        {more > 0 && <span class="q"> and {more} more</span>}
      </span>
      <Fixes own={own} />
      <AddProposals />
      <button class="btn small" id="show-blocking" onClick={() => showFinding(own)}>
        Show
      </button>
    </div>
  );
}

function Notices() {
  const { changedOnDisk, recoverable } = state.value;
  return (
    <div class="notices" role="status">
      <ActivityNote />
      <Blocking />
      {!connected.value && foreign.value && (
        <div class="note bad" id="restarted">
          <span class="grow">
            Kennfeld was restarted, and this page cannot prove that it is yours. Open the address that{" "}
            <b>kennfeld app</b> printed in its terminal; edits that were not saved are offered there.
          </span>
        </div>
      )}
      {recoverable && (
        <div class="note warn">
          <span class="grow">Kennfeld ended without saving. Its edits were kept.</span>
          <button class="btn small" onClick={() => request("recover")}>
            Recover
          </button>
          <button class="btn bare small" onClick={() => request("recover", { discard: true })}>
            Discard
          </button>
        </div>
      )}
      {screen.value !== "function" && <CodeConsent />}
      {changedOnDisk.length > 0 && (
        <div class="note warn" id="changed-on-disk">
          <span class="grow" title={changedOnDisk.join("\n")}>
            Since it was read, {changedOnDisk.slice(0, 3).join("; ")}
            {changedOnDisk.length > 3 ? `; and ${changedOnDisk.length - 3} more` : ""}.
          </span>
          <button class="btn small" onClick={() => request("reload")}>
            Read again
          </button>
        </div>
      )}
    </div>
  );
}

/** Lines of a text that another one lacks are marked. */
function Text({ title, text, other }: { title: string; text: string; other: string }) {
  const lines = new Set(other.split("\n"));
  return (
    <section class="grow">
      <h3>{title}</h3>
      <pre class="conflict">
        {text.split("\n").map((line, index) =>
          lines.has(line) ? (
            <span key={index}>
              {line}
              {"\n"}
            </span>
          ) : (
            <mark key={index}>
              {line}
              {"\n"}
            </mark>
          ),
        )}
      </pre>
    </section>
  );
}

/** Both texts of each file that another program has changed, and what to do. */
function Conflicts() {
  if (conflicts.value.length === 0 || state.value.project === null) return null;
  const cancel = (): void => {
    conflicts.value = [];
  };
  return (
    <Dialog label="Changed by another program" kind="conflicts" close={cancel}>
      <div class="head">
        <h2>Another program has changed {conflicts.value.map((each) => each.file).join(", ")}</h2>
      </div>
      <div class="pad">
        <p class="q">
          Nothing has been saved. With yours, the other changes are lost. With those on disk, yours can be brought back
          by Undo.
        </p>
        {conflicts.value
          .filter((each) => each.own !== "")
          .map((each) => (
            <div class="row" key={each.file}>
              <Text title={`${each.file} on disk`} text={each.disk} other={each.own} />
              <Text title="Yours" text={each.own} other={each.disk} />
            </div>
          ))}
        <div class="go">
          <button class="btn primary" id="take-disk" onClick={takeDisk}>
            Take those on disk
          </button>
          <button class="btn" id="replace-disk" onClick={() => save(true)}>
            Replace them with yours
          </button>
          <button class="btn bare" id="keep-both" data-first onClick={cancel}>
            Cancel
          </button>
        </div>
      </div>
    </Dialog>
  );
}
