// The question whether code of the project may run, and its addresses be used: nothing happens before the user allows
// it.

import type { FindingRow } from "./replies";
import { request, state } from "./store";

/** What the project asks for, with a button that allows it. */
export function CodeConsent() {
  const { code } = state.value;
  if (code.length === 0) return null;
  const allow = (digests: string[]) => void request("allow-code", { digests });
  const [only] = code.length === 1 ? code : [];
  return (
    <div class="note warn consent" role="group" aria-label="What the project asks for">
      <span class="grow">
        The project {only ? <b>{only.text}</b> : `asks for ${code.length} things`}, with all your rights. Allow it only
        if you trust who wrote {only ? "it" : "them"}. You are asked again if the content or the address changes.
        {!only &&
          code.map((each) => (
            <span class="row" key={each.digest}>
              <b class="grow cut" title={each.text}>
                {each.text}
              </b>
              <button class="btn small" onClick={() => allow([each.digest])}>
                Allow
              </button>
            </span>
          ))}
      </span>
      <button class="btn small primary" onClick={() => allow(code.map((each) => each.digest))}>
        {only ? "Allow" : "Allow all"}
      </button>
    </div>
  );
}

/** True if a message says what `CodeConsent` asks. */
export const isAsked = (finding: FindingRow): boolean =>
  finding.severity === "error" &&
  state.value.code.some((each) => finding.message.startsWith(`${each.text}, and has not been allowed to`));
