// The data: files and their use, channels, and what the function reads of them.

import { effect } from "@preact/signals";
import { newest } from "../connection";
import { count, counted, MISSING, significant } from "../drawing/numbers";
import { addFiles } from "../dropping";
import { NumberField, Segment, TextField } from "../fields";
import { Footer, Key } from "../frame";
import { Icon } from "../icons";
import { FindingLine } from "../instruments/finding";
import { Proposals } from "../instruments/proposals";
import { SettingsButton } from "../instruments/settings-panel";
import { openEntry, panel } from "../navigation";
import type { ChannelRow, DatasetFiles, MappedInput, RecordingFile } from "../replies";
import { scoped } from "../scope";
import { setKeys } from "../settings";
import { request, screen, settled, state } from "../store";
import { DataSettings } from "./data/settings";

const entries = scoped<DatasetFiles[]>([]);
const inputs = scoped<MappedInput[]>([]);
const search = scoped("");
const closed = scoped(new Set<string>());

const load = newest(async (_: number) => {
  const reply = await request("files");
  if (reply === null) return;
  entries.value = reply.head.datasets;
  inputs.value = reply.head.inputs;
});

effect(() => {
  const { revision, project } = settled.value;
  if (screen.value === "data" && project !== null) load(revision);
});

export function Data() {
  return (
    <>
      <main class={`data ${panel.data.value ? "open" : ""}`}>
        <FileList />
        <Channels />
        <Mapping />
        <DataSettings />
      </main>
      <Footer>
        <Key keys={["Ctrl", "Z"]} text="undo" />
        <span>drop files anywhere</span>
      </Footer>
    </>
  );
}

function FileList() {
  return (
    <section class="pane files">
      <div class="head">
        <h2>Files</h2>
        <span class="sub">
          {counted(
            entries.value.reduce((sum, e) => sum + e.files.length, 0),
            "file",
          )}{" "}
          in {counted(entries.value.length, "dataset")}
        </span>
        <span class="right">
          <SettingsButton own={panel.data} first="dataset" />
          <label class="btn small">
            <Icon name="plus" />
            Add files
            <input type="file" multiple hidden onChange={(event) => addFiles([...(event.currentTarget.files ?? [])])} />
          </label>
          <span class="q">or drop them anywhere</span>
        </span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>file</th>
            <th>dataset</th>
            <th>use</th>
            <th class="num">weight</th>
            <th class="num">samples</th>
            <th class="num">rate</th>
            <th class="num">length</th>
            <th>missing</th>
            <th>where</th>
            <th class="num">raster</th>
            <th class="num">warm-up</th>
            <th>
              <span class="unseen">remove</span>
            </th>
          </tr>
        </thead>
        <tbody>
          {entries.value.map((entry) =>
            entry.files.map((file, k) => <FileRow entry={entry} file={file} first={k === 0} />),
          )}
        </tbody>
      </table>
      {entries.value.length === 0 && (
        <p class="pad q">
          Recordings to calibrate with: MDF, CSV, Excel, Parquet, MATLAB or logger files. Drop them here.
        </p>
      )}
    </section>
  );
}

function FileRow({ entry, file, first }: { entry: DatasetFiles; file: RecordingFile; first: boolean }) {
  const at = entry.number;
  const own = state.value.datasets[at - 1];
  return (
    <tr class={entry.use === "off" ? "off" : ""}>
      <td>
        <Icon name="file" /> <b>{file.name}</b>
      </td>
      <td>
        {first && (
          <button
            class="fold link"
            title="All settings of the dataset"
            onClick={() => {
              panel.data.value = "dataset";
              openEntry("dataset", at);
            }}
          >
            {entry.name || own?.name}
          </button>
        )}
      </td>
      <td>
        {first && (
          <Segment
            label={`Use of ${file.name}`}
            options={["training", "test"]}
            chosen={entry.use}
            choose={(use) =>
              setKeys([[["dataset", at, "use"], use === "training" ? null : use]], `${file.name}: ${use} data`)
            }
          />
        )}
      </td>
      <td class="num">
        {first && <NumberField path={["dataset", at, "weight"]} label={`Weight of ${file.name}`} width={44} />}
      </td>
      {file.error ? (
        <td colSpan={4} class="bad fault">
          {file.error}
        </td>
      ) : file.note ? (
        <td colSpan={4} class="q">
          {file.note}
        </td>
      ) : (
        <>
          <td class="num">{count(file.samples ?? 0)}</td>
          <td class="num">{file.step ? `${significant(1 / file.step, 3)} Hz` : MISSING}</td>
          <td class="num">{file.length ? `${significant(file.length, 4)} s` : MISSING}</td>
          <td>
            {file.missing ? (
              <span class="tag w" title={`The largest share that a channel lacks: ${file.sparsest ?? ""}`}>
                {(file.missing * 100).toFixed(1)} %
              </span>
            ) : (
              <span class="q">none</span>
            )}
          </td>
        </>
      )}
      <td>
        {first && (
          <TextField
            path={["dataset", at, "where"]}
            label={`Condition of ${file.name}`}
            placeholder="all samples"
            width={120}
            mono
          />
        )}
      </td>
      <td class="num">
        {first && (
          <NumberField path={["dataset", at, "raster"]} label={`Raster of ${file.name}`} placeholder="own" width={58} />
        )}
      </td>
      <td class="num">
        {first && <NumberField path={["dataset", at, "warmup"]} label={`Warm-up of ${file.name}`} width={50} />}
      </td>
      <td>
        {first && (
          <button
            class="btn bare small"
            title="Remove the dataset from the project; the file stays"
            aria-label={`Remove ${file.name}`}
            onClick={() => setKeys([[["dataset", at], null]], `Removed ${entry.name || file.name}`)}
          >
            ×
          </button>
        )}
      </td>
    </tr>
  );
}

function Channels() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const feeds = new Map(inputs.value.map((each) => [each.channel, each.role === "target" ? "target" : each.name]));
  const files = entries.value.flatMap((entry) => entry.files);
  return (
    <section class="pane channels">
      <div class="head">
        <h2>Channels</h2>
        <span class="right q">
          {files.reduce((sum, f) => sum + f.channels.length, 0)} in {files.length} files
        </span>
      </div>
      <div class="filter">
        <label class="field" style={{ width: "100%" }}>
          <Icon name="find" kind="q" />
          <input
            placeholder="Name, unit"
            aria-label="Search channels"
            value={search.value}
            onInput={(event) => {
              search.value = event.currentTarget.value;
            }}
          />
        </label>
      </div>
      <div class="items" role="region" aria-label="Channels" tabIndex={0}>
        <table class="list tree">
          <thead>
            <tr>
              <th>name</th>
              <th>unit</th>
              <th class="num">least</th>
              <th class="num">greatest</th>
              <th>feeds</th>
            </tr>
          </thead>
          {files.map((file) => {
            const open = !closed.value.has(file.name);
            const shown = file.channels.filter((c) =>
              words.every((word) => `${c.name} ${c.unit}`.toLowerCase().includes(word)),
            );
            return (
              <tbody>
                <tr
                  class="group"
                  onClick={() => {
                    const next = new Set(closed.value);
                    if (!next.delete(file.name)) next.add(file.name);
                    closed.value = next;
                  }}
                >
                  <td colSpan={4}>
                    {open ? "⌄" : "›"} {file.name}
                  </td>
                  <td class="q num">{file.channels.length}</td>
                </tr>
                {open &&
                  shown.map((c, k) => (
                    <>
                      {c.group && c.group !== shown[k - 1]?.group && (
                        <tr class="raster">
                          <td colSpan={5}>{c.group}</td>
                        </tr>
                      )}
                      <tr>
                        <td class="mono" title={c.name}>
                          {c.name}
                        </td>
                        <td class="q">{c.unit}</td>
                        <td class="num">{c.least === null ? MISSING : significant(c.least)}</td>
                        <td class="num">{c.greatest === null ? MISSING : significant(c.greatest)}</td>
                        <td class="acc">{feeds.get(c.name) ?? ""}</td>
                      </tr>
                    </>
                  ))}
              </tbody>
            );
          })}
        </table>
      </div>
    </section>
  );
}

/** The channels by name, each with its range over all files. */
function ranges(files: RecordingFile[]): Map<string, ChannelRow> {
  const channels = new Map<string, ChannelRow>();
  for (const own of files.flatMap((file) => file.channels)) {
    const known = channels.get(own.name);
    if (known === undefined || known.least === null) channels.set(own.name, own);
    else if (own.least !== null)
      channels.set(own.name, {
        ...known,
        least: Math.min(known.least, own.least),
        greatest: Math.max(known.greatest!, own.greatest!),
      });
  }
  return channels;
}

function Mapping() {
  const channels = [
    ...new Set(entries.value.flatMap((entry) => entry.files.flatMap((file) => file.channels.map((c) => c.name)))),
  ];
  const described = ranges(entries.value.flatMap((entry) => entry.files));
  const remarks = state.value.findings.filter((f) => f.screen === "data" && f.severity !== "remark");
  return (
    <section class="pane mapping">
      <div class="head">
        <h2>What the function reads</h2>
        <span class="sub">proposed by name, units checked</span>
      </div>
      <table class="list">
        <thead>
          <tr>
            <th>input</th>
            <th>unit</th>
            <th>channel</th>
            <th>unit of the channel</th>
            <th class="num">range in the data</th>
          </tr>
        </thead>
        <tbody>
          {inputs.value.map((each) => {
            const own = described.get(each.channel);
            return (
              <tr>
                <td>
                  <b>{each.name}</b> {each.role === "target" && <span class="tag t">target</span>}
                </td>
                <td class="q">{each.unit || MISSING}</td>
                <td>
                  <select
                    class="field small"
                    style={{ width: "160px" }}
                    aria-label={`Channel of ${each.name}`}
                    value={each.channel}
                    onChange={(event) => map(each, event.currentTarget.value)}
                  >
                    {(channels.includes(each.channel) ? channels : [each.channel, ...channels]).map((name) => (
                      <option value={name}>{name}</option>
                    ))}
                  </select>
                </td>
                <td class={own === undefined ? "bad" : ""}>
                  {own === undefined ? "no such channel" : own.unit || MISSING}
                </td>
                <td class="num">
                  {own && own.least !== null ? `${significant(own.least)} … ${significant(own.greatest!)}` : MISSING}
                </td>
              </tr>
            );
          })}
        </tbody>
      </table>
      {inputs.value.length === 0 && (
        <p class="pad q">
          The inputs of the function are listed here once its text is written.{" "}
          <button
            class="btn small"
            onClick={() => {
              screen.value = "function";
            }}
          >
            Function
          </button>
        </p>
      )}
      <Proposals />
      {remarks.length > 0 && (
        <div class="cks">
          {remarks.map((f) => (
            <FindingLine key={f.text} own={f} />
          ))}
        </div>
      )}
    </section>
  );
}

function map(own: MappedInput, channel: string): void {
  const title = `${own.name} is read from ${channel}`;
  if (own.role === "target") void setKeys([[["criterion", own.number!, "target"], { channel }]], title);
  else void setKeys([[["channels", own.name], channel === own.name ? null : channel]], title);
}
