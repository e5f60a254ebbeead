// Which file is the function, and how to begin another one.

import { FUNCTION_FILES, fileOf } from "../../function-files";
import { request } from "../../store";
import { choose, files, functionFile, takeFiles } from "./source";

const NEW = "\0new"; // cannot be the name of a file

export function FunctionChoice() {
  const own = fileOf(functionFile.value);
  const known = own === "" || files.value.includes(own) ? files.value : [own, ...files.value];
  return (
    <span class="row choice">
      <select
        class="field small"
        aria-label="File of the function"
        value={own}
        title="The file that is the function&#10;[model] file"
        onChange={(event) => {
          const file = event.currentTarget.value;
          event.currentTarget.value = own;
          if (file === NEW) void request("new-function");
          else choose(file);
        }}
      >
        {own === "" && <option value="">no function</option>}
        {known.map((name) => (
          <option value={name}>{name}</option>
        ))}
        <option value={NEW}>New formula text…</option>
      </select>
      <OpenModel text="Model…" />
    </span>
  );
}

/** Open a model from the user's machine. */
export function OpenModel({ text, kind = "small" }: { text: string; kind?: string }) {
  return (
    <label
      class={`btn ${kind}`}
      title="Open a Simulink model, .slx or .mdl, files of an ASCET project, .esdl and .app, an FMU, a network, .onnx, or a function in C or Python, .c or .py. They are stored beside the project. Or drop them on the page."
    >
      {text}
      <input
        type="file"
        accept={`.slx,.mdl,.slxp,.esdl,.app,.h,${FUNCTION_FILES}`}
        multiple
        hidden
        onChange={(event) => {
          void takeFiles([...(event.currentTarget.files ?? [])]);
          event.currentTarget.value = "";
        }}
      />
    </label>
  );
}
