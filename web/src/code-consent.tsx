// The question whether code of other tools may run: nothing is evaluated before the user has allowed it.

import { request, state, type Finding } from "./store";

/** Files whose code the model runs, with a button that allows it for their present content. */
export function CodeConsent() {
  const { code } = state.value;
  if (code.length === 0) return null;
  const allow = (digests: string[]) => void request("allow-code", { digests });
  const [only] = code.length === 1 ? code : [];
  return (
    <div class="note warn consent" role="group" aria-label="Code of other tools">
      <span class="grow">The model runs code of {only ? <b>{only.file}</b> : `${code.length} files`} with all your rights. Allow it only if you trust {only ? "this file" : "them"}. You are asked again if the content changes.
        {!only && code.map((each) => <span class="row" key={each.file}><b class="grow cut">{each.file}</b><button class="btn small" onClick={() => allow([each.digest])}>Allow</button></span>)}</span>
      <button class="btn small primary" onClick={() => allow(code.map((each) => each.digest))}>{only ? "Allow" : "Allow all"}</button>
    </div>
  );
}

/** True if a message says what `CodeConsent` asks. */
export const isAsked = (finding: Finding): boolean => finding.severity === "error" && state.value.code.some((each) => finding.message.startsWith(`runs code of ${each.file},`));
