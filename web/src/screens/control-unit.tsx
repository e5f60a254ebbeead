// Into the control unit: the values are rounded to its storage, and written with the function as C, FMU and files.

import { busy, compareCode, existing, round, unit, writeFiles } from "../control-unit";
import { Footer, Key } from "../frame";
import { useScreenKeys } from "../screen-keys";
import { blocking, state } from "../store";
import { CodePane } from "./control-unit/code";
import { FilesPane, FmuPane } from "./control-unit/files";
import { RoundingPane } from "./control-unit/rounding";
import "./control-unit.css";

function takeKey(event: KeyboardEvent, typing: boolean): boolean {
  if (typing) return false;
  const button = document.getElementById({ r: "round", c: "compare-code", w: "write-unit" }[event.key] ?? "");
  if (!(button instanceof HTMLButtonElement) || button.disabled) return false;
  if (event.key === "r") void round();
  else if (event.key === "c") void compareCode();
  else if (existing.value.length === 0) void writeFiles(false);
  return true;
}

export function ControlUnitScreen() {
  useScreenKeys(takeKey);
  const empty = state.value.parameters.length === 0 || state.value.criteria.length === 0;
  return (
    <>
      <main class="unit">
        {empty || unit.value === null ? (
          <section class="pane all">
            <div class="head">
              <h2>Into the control unit</h2>
            </div>
            <p class="pad q" id="unit-empty">
              {!empty
                ? "Reading how the values are stored"
                : `Values are rounded and written here, with the function as C code or FMU, once the project can be evaluated.${
                    blocking.value === null ? "" : ` It cannot yet: ${blocking.value.text}`
                  }`}
            </p>
          </section>
        ) : (
          <>
            <RoundingPane own={unit.value} />
            <CodePane own={unit.value} />
            <FmuPane own={unit.value} />
            <FilesPane own={unit.value} />
          </>
        )}
      </main>
      <Footer>
        {busy.value && (
          <span class="acc" id="unit-busy">
            {busy.value}
          </span>
        )}
        <Key keys={["r"]} text="round" />
        <Key keys={["c"]} text="compile and compare" />
        <Key keys={["w"]} text="write all chosen" />
        <Key keys={["Alt", "E"]} text="this screen" />
      </Footer>
    </>
  );
}
