// What is done with two sets of values: take labels into the project, write a merged or converted file, use a file as
// start.

import {
  comparison,
  descriptions,
  existing,
  folder,
  shown,
  sides,
  take,
  ticked,
  write,
  written,
} from "../../calibrations";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import { RoundedTable } from "../../instruments/rounded";
import type { Toml } from "../../replies";
import { scoped } from "../../scope";
import { setKeys } from "../../settings";
import { address } from "../../uploads";

const kind = scoped<"merged" | "converted">("merged");
const name = scoped("");
const ending = scoped(".dcm");
const image = scoped("");
const remarks = scoped<string[]>([]);

const isImage = (text: string): boolean => /\.(hex|ihex|s19|s28|s37|srec|mot)$/i.test(text);

export function Actions() {
  return (
    <section class="pane ac">
      <Take />
      <WriteFile />
      <Initial />
    </section>
  );
}

function Take() {
  const rows = (comparison.value?.rows ?? []).filter((row) => row.takeable && ticked.value.has(row.label));
  return (
    <>
      <div class="head">
        <h2>Take into the project</h2>
      </div>
      <div class="pad">
        <p class="q">
          The ticked parameters of {comparison.value?.labels[1] ?? "the second set"} replace the present values; other
          axes are interpolated. Undo takes it back.
        </p>
        <div class="go">
          <button
            class="btn primary"
            id="take-values"
            disabled={rows.length === 0 || shown.value === "contents" || sides.second.value === "now"}
            onClick={async () => {
              remarks.value = (await take()) ?? [];
            }}
          >
            Take {rows.length} parameter{rows.length === 1 ? "" : "s"}
          </button>
        </div>
        {remarks.value.map((text) => (
          <p class="note">{text}</p>
        ))}
      </div>
    </>
  );
}

function WriteFile() {
  const { endings, files, descriptions: described } = folder.value;
  const merged = kind.value === "merged" && shown.value !== "contents";
  const target = `${name.value.trim() || (merged ? "merged" : "converted")}${ending.value}`;
  const exists = existing.value === target;
  const run = (force: boolean) =>
    write({
      merged,
      target,
      image: isImage(target) ? image.value : "",
      a2l: isImage(target) ? (descriptions.value[image.value] ?? "") : "",
      force,
    });
  const result = written.value;
  return (
    <>
      <div class="head mid">
        <h2>Write a file</h2>
        <span class="right">
          <Segment
            label="What is written"
            options={["merged", "converted"]}
            chosen={merged ? "merged" : "converted"}
            choose={(option) => {
              kind.value = option as typeof kind.value;
            }}
          />
        </span>
      </div>
      <div class="pad">
        <p class="q">
          {merged
            ? `${comparison.value?.labels[0] ?? "The first set"} with the ${ticked.value.size} ticked labels of ${comparison.value?.labels[1] ?? "the second"}.`
            : `${comparison.value?.labels[1] ?? "The second set"}, in the format of the ending.`}
        </p>
        <div class="row">
          <span class="field small grow">
            <input
              aria-label="Name of the file"
              id="target-name"
              placeholder={merged ? "merged" : "converted"}
              value={name.value}
              onInput={(event) => {
                name.value = event.currentTarget.value;
              }}
            />
          </span>
          <select
            class="field small"
            aria-label="Format"
            id="target-ending"
            value={ending.value}
            onChange={(event) => {
              ending.value = event.currentTarget.value;
            }}
          >
            {endings.map((each) => (
              <option value={each}>{each}</option>
            ))}
          </select>
        </div>
        {isImage(target) && (
          <div class="row">
            <span class="q">copy of</span>
            <select
              class="field small grow"
              aria-label="Image to write the values into"
              title="The image whose copy gets the values; without a choice the one that the set was read from"
              value={image.value}
              onChange={(event) => {
                image.value = event.currentTarget.value;
              }}
            >
              <option value="">the image of the set</option>
              {files
                .filter((file) => file.image)
                .map((file) => (
                  <option value={file.name}>{file.name}</option>
                ))}
            </select>
          </div>
        )}
        {isImage(target) && image.value !== "" && described.length > 1 && (
          <div class="row">
            <span class="q">described by</span>
            <select
              class="field small grow"
              aria-label="A2L file of the image"
              value={descriptions.value[image.value] ?? ""}
              onChange={(event) => {
                descriptions.value = { ...descriptions.value, [image.value]: event.currentTarget.value };
              }}
            >
              <option value="">its A2L</option>
              {described.map((each) => (
                <option value={each}>{each}</option>
              ))}
            </select>
          </div>
        )}
        <div class="go">
          <button class="btn" id="write-file" onClick={() => run(false)}>
            Write {target}
          </button>
          {exists && (
            <button class="btn" id="replace-file" onClick={() => run(true)}>
              Replace it
            </button>
          )}
        </div>
        {exists && <p class="note warn">{target} exists already.</p>}
        {result && (
          <div class="done" id="written">
            <p class="good">
              Written:{" "}
              <a href={address(result.file)} download>
                {result.file}
              </a>
            </p>
            {result.changes.slice(0, 40).map((each) => (
              <p class="cut" title={each.details}>
                {each.name} <span class="q">{each.action}</span>
              </p>
            ))}
          </div>
        )}
        {result?.findings.map((text) => (
          <p class="note warn">{text}</p>
        ))}
      </div>
      <RoundedTable rows={result?.rounded ?? []} />
    </>
  );
}

/** Initial files of the project: a calibration file, or an image with its A2L file. */
function Initial() {
  const { initial } = folder.value;
  const value = sides.second.value;
  const file = value.startsWith("file:") ? value.slice(5) : "";
  const shownAs = (entry: Toml): string =>
    typeof entry === "object" && !Array.isArray(entry) ? Object.values(entry).join(" with ") : String(entry);
  const names = initial.map((entry) =>
    typeof entry === "object" && !Array.isArray(entry) ? String(entry.hex) : String(entry),
  );
  const a2l = descriptions.value[file] || "";
  const entry: Toml = isImage(file) && a2l ? { a2l, hex: file } : isImage(file) ? { hex: file } : file;
  return (
    <>
      <div class="head mid">
        <h2>Initial values</h2>
        <span class="sub">later files win</span>
      </div>
      <div class="pad">
        {initial.length === 0 && <p class="q">The project has no initial file.</p>}
        {initial.map((each, k) => (
          <p class="row">
            <Icon name="file" />
            <span class="grow cut" title={shownAs(each)}>
              {shownAs(each)}
            </span>
            <button
              class="btn bare small"
              aria-label={`Remove ${shownAs(each)}`}
              title="Remove it from [calibration] initial; the file stays"
              onClick={() =>
                setKeys(
                  [[["calibration", "initial"], initial.length > 1 ? initial.filter((_, other) => other !== k) : null]],
                  `Removed ${shownAs(each)} from the initial files`,
                )
              }
            >
              ×
            </button>
          </p>
        ))}
        <div class="go">
          <button
            class="btn"
            id="use-initial"
            title="Adds it to [calibration] initial"
            disabled={!file || names.includes(file)}
            onClick={() =>
              setKeys(
                [
                  [
                    ["calibration", "initial"],
                    [...initial, entry],
                  ],
                ],
                `${file} is an initial file`,
              )
            }
          >
            {file ? `Start from ${file}` : "Choose a file"}
          </button>
        </div>
      </div>
    </>
  );
}
