// Functions of other tools that formula text calls: how each is called, what is wrong with it, and a button that adds
// files.

import { FUNCTION_FILES } from "../../function-files";
import { Icon } from "../../icons";
import type { CalledFunction } from "../../replies";
import { setKeys } from "../../settings";
import { droppedFiles } from "../../uploads";
import { addCalled, calledFunctions, setCalled } from "./file-source";
import { Fold } from "./fold";
import { range } from "./import-lists";

export function CalledFunctions() {
  const all = calledFunctions.value;
  const wrong = all.filter((each) => each.problems.length > 0).length;
  return (
    <div onDragOver={(event) => event.preventDefault()} onDrop={drop}>
      <Fold
        title="Functions of other tools"
        sub={all.length ? `${all.length} can be called${wrong ? `, ${wrong} to solve` : ""}` : "FMU, ONNX, C, Python"}
        name="functions"
        open={wrong > 0}
      >
        {all.map((own) => (
          <Called key={own.name} own={own} />
        ))}
        <p class="pad">
          <label
            class="btn small"
            title={`Files that hold functions (${FUNCTION_FILES.replaceAll(",", ", ")}). They are stored beside the project; formula text calls them like a table.\n[functions]`}
          >
            <Icon name="plus" />
            Add files
            <input
              type="file"
              multiple
              accept={`${FUNCTION_FILES},.h`}
              aria-label="Files of functions"
              hidden
              onChange={(event) => {
                void addCalled([...(event.currentTarget.files ?? [])]);
                event.currentTarget.value = "";
              }}
            />
          </label>{" "}
          <span class="q">or drop them here</span>
        </p>
      </Fold>
    </div>
  );
}

/** Files that are dropped here are called; elsewhere on the screen they become the function. */
function drop(event: DragEvent): void {
  event.preventDefault();
  event.stopPropagation();
  void droppedFiles(event).then(addCalled);
}

function Called({ own }: { own: CalledFunction }) {
  return (
    <div class="surrogate" data-called={own.name}>
      <div class="row">
        <b class="ink">{own.name}</b>
        <span class="q cut" title={own.reference}>
          {own.reference}
        </span>
        {own.problems.length > 0 ? (
          <span class="tag b">{own.problems.length} to solve</span>
        ) : (
          own.runs && (
            <span class="tag w" title="Its code runs at each step">
              runs code
            </span>
          )
        )}
        <span class="right">
          <FunctionOf own={own} />
          <button
            class="btn bare small"
            aria-label={`Remove ${own.name}`}
            title="Formula text no longer calls it; the file stays"
            onClick={() => {
              void setKeys([[["functions", own.name], null]], `${own.name} is removed`);
            }}
          >
            ×
          </button>
        </span>
      </div>
      {own.calls.map((call) => (
        <p class="mono cut" title={call.signature}>
          {call.signature}
          {call.unit && <span class="q"> [{call.unit}]</span>}
        </p>
      ))}
      {own.problems.map((problem) => (
        <p class="bad" role="alert">
          {problem.text}
        </p>
      ))}
      {own.parameters.length > 0 && (
        <p class="q cut" title={own.parameters.map((each) => `${each.name} = ${range(each)} ${each.unit}`).join("\n")}>
          Parameters: {own.parameters.map((each) => each.name).join(", ")}
        </p>
      )}
      {own.notes.length > 0 && (
        <details>
          <summary class="q">
            {own.notes.length} {own.notes.length === 1 ? "remark" : "remarks"}
          </summary>
          {own.notes.map((note) => (
            <p>{note}</p>
          ))}
        </details>
      )}
    </div>
  );
}

/** The choice of the function, if the file holds several. */
function FunctionOf({ own }: { own: CalledFunction }) {
  if (!own.named || own.functions.length === 0 || (own.functions.length === 1 && own.function === own.functions[0]))
    return null;
  return (
    <select
      class="field small"
      aria-label={`Function of ${own.name}`}
      title={`[functions] ${own.name}`}
      value={own.function}
      onChange={(event) => setCalled(own, event.currentTarget.value)}
    >
      {!own.functions.includes(own.function) && (
        <option value={own.function}>{own.function || "choose a function"}</option>
      )}
      {own.functions.map((name) => (
        <option value={name}>{name}</option>
      ))}
    </select>
  );
}
