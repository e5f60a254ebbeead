// Lists of an import: ports with their channels, and folders that are searched; ranges of values.

import { MISSING, plain } from "../../drawing/numbers";
import { Icon } from "../../icons";
import type { CalibratableParameter, NamedUnit } from "../../replies";
import { setKeys, valueAt } from "../../settings";
import { state } from "../../store";
import { setTexts, textsAt } from "./source";

export const range = (each: CalibratableParameter): string =>
  each.smallest === each.largest ? plain(each.smallest) : `${plain(each.smallest, 4)} … ${plain(each.largest, 4)}`;
export const limits = (each: CalibratableParameter): string =>
  each.lower === null && each.upper === null ? "" : `limits ${each.lower ?? "−∞"} … ${each.upper ?? "∞"}`;

interface FolderProps {
  title: string;
  sub: string;
  word: string;
  accept: string;
  add: (files: File[]) => void;
}

/** Folders that are searched besides that of the model, and a button for files from the user's machine. */
export function Folders({ title, sub, word, accept, add }: FolderProps) {
  const folders = textsAt(["model", "folders"]);
  return (
    <>
      <div class="head mid">
        <h2>{title}</h2>
        <span class="sub">{sub}</span>
        <span class="right">
          <label
            class="btn small"
            title={`Files with ${word} (${accept.replaceAll(",", ", ")}); they are stored beside the model`}
          >
            <Icon name="plus" />
            Files
            <input
              type="file"
              multiple
              accept={accept}
              hidden
              onChange={(event) => add([...(event.currentTarget.files ?? [])])}
            />
          </label>
        </span>
      </div>
      <div class="chips">
        {folders.map((folder) => (
          <span class="chip">
            <Icon name="folder" kind="q" />
            {folder}
            <button
              class="link"
              aria-label={`Remove ${folder}`}
              onClick={() =>
                setTexts(
                  ["model", "folders"],
                  folders.filter((each) => each !== folder),
                  `${folder} is not searched`,
                )
              }
            >
              ×
            </button>
          </span>
        ))}
        <span class="field small" style={{ width: "140px" }}>
          <input
            aria-label={`Folder of ${word}`}
            placeholder="folder to search"
            title={`A folder with ${word}, relative to the project\n[model] folders`}
            onChange={(event) => {
              const name = event.currentTarget.value.trim();
              event.currentTarget.value = "";
              if (name) setTexts(["model", "folders"], [...folders, name], `Also searched: ${name}`);
            }}
          />
        </span>
      </div>
    </>
  );
}

/** The inputs of the function with the channels that they are read from, and its outputs. */
export function Ports({
  own,
  name = "inport",
}: {
  own: { inputs?: NamedUnit[]; outputs?: NamedUnit[] };
  name?: string;
}) {
  const { inputs = [], outputs = [] } = own;
  if (inputs.length + outputs.length === 0) return null;
  const channels = [...new Set(state.value.datasets.flatMap((data) => data.channels.map((each) => each.name)))];
  return (
    <>
      <div class="head mid">
        <h2>Ports</h2>
        <span class="sub">{inputs.length > 0 && "to the channels of the data"}</span>
      </div>
      {inputs.length > 0 && (
        <table class="list">
          <thead>
            <tr>
              <th>{name}</th>
              <th>unit</th>
              <th>channel</th>
              <th>
                <span class="unseen">more</span>
              </th>
            </tr>
          </thead>
          <tbody>
            {inputs.map((port) => {
              const channel = String(valueAt(["channels", port.name]) ?? port.name);
              return (
                <tr key={port.name}>
                  <td class="cut" title={port.name}>
                    <b>{port.name}</b>
                  </td>
                  <td class="q">{port.unit || MISSING}</td>
                  <td>
                    <span class="field small mono" style={{ width: "120px" }}>
                      <input
                        aria-label={`Channel of ${port.name}`}
                        list="channels"
                        value={channel}
                        title={`[channels] ${port.name}`}
                        onChange={(event) => {
                          const next = event.currentTarget.value.trim();
                          void setKeys(
                            [[["channels", port.name], next === "" || next === port.name ? null : next]],
                            `${port.name} is read from ${next || port.name}`,
                          );
                        }}
                      />
                    </span>
                  </td>
                  <td>
                    {channels.includes(channel) ? (
                      <Icon name="done" kind="good" />
                    ) : (
                      channels.length > 0 && (
                        <span title="No recording has this channel">
                          <Icon name="warning" kind="warn" />
                        </span>
                      )
                    )}
                  </td>
                </tr>
              );
            })}
          </tbody>
        </table>
      )}
      <datalist id="channels">
        {channels.map((name) => (
          <option value={name} />
        ))}
      </datalist>
      <p class="pad q">
        Outputs: {outputs.map((port) => `${port.name}${port.unit ? ` [${port.unit}]` : ""}`).join(", ") || MISSING}
      </p>
    </>
  );
}
