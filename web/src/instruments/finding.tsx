// What a message offers: the fixes that the server knows, each on a button, and the place where it is solved.

import { Icon } from "../icons";
import { showFinding } from "../navigation";
import type { FindingRow, FixRow } from "../replies";
import { message, request } from "../store";

async function apply(own: FindingRow, { title }: FixRow, option = ""): Promise<void> {
  const reply = await request("apply-fix", { finding: own.text, fix: title, option });
  if (reply !== null) message.value = `${title}${option && ` ${option}`}. Undo takes it back.`;
}

/** The fixes of a message; one that needs a name is a list to choose from. */
export function Fixes({ own }: { own: FindingRow }) {
  return (
    <>
      {own.fixes.map((fix) =>
        fix.options.length > 0 ? (
          <select
            key={fix.title}
            class="field small fix"
            aria-label={fix.title}
            value=""
            onChange={(event) => {
              const { value } = event.currentTarget;
              event.currentTarget.value = "";
              if (value) void apply(own, fix, value);
            }}
          >
            <option value="">{fix.title}…</option>
            {fix.options.map((option) => (
              <option key={option} value={option}>
                {option}
              </option>
            ))}
          </select>
        ) : (
          <button key={fix.title} class="btn small fix" title="Undo takes it back" onClick={() => void apply(own, fix)}>
            {fix.title}
          </button>
        ),
      )}
    </>
  );
}

/** A message in a list, with its fixes, and a button that shows the field it is about. */
export function FindingLine({ own }: { own: FindingRow }) {
  const isRemark = own.severity === "remark";
  return (
    <div class={`ck ${isRemark ? "i" : "w"}`}>
      <Icon name={isRemark ? "find" : "warning"} />
      <span class="grow">{own.text}</span>
      <Fixes own={own} />
      {!isRemark && (
        <button class="btn small" onClick={() => showFinding(own)}>
          Show
        </button>
      )}
    </div>
  );
}
