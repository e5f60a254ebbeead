// The messages about the function; a click goes to the character.

import { isAsked } from "../../code-consent";
import { Icon } from "../../icons";
import { Fixes } from "../../instruments/finding";
import { correct, spellings } from "../../instruments/spellings";
import { jump } from "../../jump";
import { state } from "../../store";

export function Messages() {
  const own = state.value.findings.filter((each) => each.screen === "function" && !isAsked(each));
  if (own.length === 0) return null;
  return (
    <div class="cks" role="list" aria-label="Messages">
      {own.map((each) => (
        <div class={`ck ${each.severity === "remark" ? "i" : "w"}`} role="listitem">
          <Icon name={each.severity === "remark" ? "find" : "warning"} />
          {each.line > 0 ? (
            <button
              class="grow link plain"
              title="Go to the character (F8)"
              onClick={() => {
                jump.value = { file: each.file, line: each.line, column: each.column };
              }}
            >
              {each.text}
            </button>
          ) : (
            <span class="grow">{each.text}</span>
          )}
          <Fixes own={each} />
          {spellings.value
            .filter((word) => word.line === each.line && word.column === each.column)
            .map((word) => (
              <button class="btn small" title={`Replace ${word.word}`} onClick={() => correct(word)}>
                Use {word.similar}
              </button>
            ))}
        </div>
      ))}
    </div>
  );
}
