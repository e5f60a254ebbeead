// What an import needs and what stops it: unsupported blocks, variables and their files, ports, and what runs
// differently.

import { parseNumber, plain } from "../../drawing/numbers";
import { Icon } from "../../icons";
import { NumberInput } from "../../inputs";
import type { BlockingBlock, FileProposal, ImportedFunction } from "../../replies";
import { setKeys } from "../../settings";
import { Binding, Bindings, binding } from "./bindings";
import { reveal } from "./block-tree";
import { Folders, limits, Ports, range } from "./import-lists";
import { addLibraries, addValueFiles, diagram, setTexts, textsAt } from "./source";

const FEW = 4; // blocks with the same reason that are listed at once

export function ImportState() {
  const own = diagram.value;
  if (own === null) return <p class="pad q">Reading the model</p>;
  const stops = (own.blocking ?? []).filter((block) => block.stops);
  const others = (own.blocking ?? []).filter((block) => !block.stops);
  return (
    <div class="import">
      <Binding />
      {[...own.problems, ...(own.stopped ?? [])].map((problem) => (
        <div class="note bad" role="alert">
          <Icon name="warning" />
          <span>{problem.text}</span>
        </div>
      ))}
      {(own.proposals ?? []).map((proposal) => (
        <Proposal key={proposal.text} proposal={proposal} />
      ))}
      {grouped(stops).map((blocks) => (
        <Stop key={blocks[0]!.path} blocks={blocks} />
      ))}
      {(own.loops ?? []).map((loop) => (
        <Loop key={loop.join()} loop={loop} />
      ))}
      <Bindings />
      {own.whole && Object.keys(own.bind).length === 0 && (
        <p class="pad q">
          <Icon name="done" kind="good" /> Nothing stops it: all {own.total} blocks are supported.
        </p>
      )}
      {own.blocks !== undefined && (
        <>
          <Variables own={own} />
          <Folders
            title="Libraries"
            sub="searched beside the model, too"
            word="libraries, referenced models and functions"
            accept=".slx,.mdl,.m"
            add={addLibraries}
          />
          <Ports own={own} />
        </>
      )}
      {others.length > 0 && (
        <details class="more">
          <summary>{others.length} unsupported blocks that no output depends on</summary>
          {grouped(others).map((blocks) => (
            <Stop key={blocks[0]!.path} blocks={blocks} />
          ))}
        </details>
      )}
      <Notes own={own} />
    </div>
  );
}

/** A file or folder of the project that supplies what is missing, with a button for it and for each alternative. */
function Proposal({ proposal }: { proposal: FileProposal }) {
  const path = ["model", proposal.key];
  const values = textsAt(path).filter((each) => !proposal.values.includes(each));
  return (
    <div class="note warn" data-proposal={proposal.values[0]}>
      <Icon name="find" />
      <span class="grow">
        {proposal.text}.
        <span class="row">
          {proposal.values.map((value) => (
            <button
              key={value}
              class="btn small"
              title={`Import the model with ${value}\n[model] ${proposal.key}`}
              onClick={() => setTexts(path, [...values, value], `Also read: ${value}`)}
            >
              Use {value}
            </button>
          ))}
        </span>
      </span>
    </div>
  );
}

/** Blocks with the same reason and remedy, together. */
function grouped(blocks: BlockingBlock[]): BlockingBlock[][] {
  const groups = new Map<string, BlockingBlock[]>();
  for (const block of blocks) {
    const key = `${block.why}\n${block.remedy}`;
    groups.set(key, [...(groups.get(key) ?? []), block]);
  }
  return [...groups.values()];
}

/** Why blocks are not supported, with a button for each that binds it. */
function Stop({ blocks }: { blocks: BlockingBlock[] }) {
  const [first] = blocks;
  const sentence = `${first!.why}${/[.!?]$/.test(first!.why) ? "" : "."} ${first!.remedy}`.replaceAll(
    "`folders`",
    "Libraries",
  );
  return (
    <div class={`note ${first!.stops ? "warn" : ""}`}>
      <Icon name="warning" />
      <span class="grow">
        {blocks.length > 1 && <b>{blocks.length} blocks: </b>}
        {sentence}
        {first!.needsStep && <FixedStep />}
        {blocks.slice(0, FEW).map((block) => (
          <StopRow key={block.path} block={block} text={blocks.length > 1 ? "Bind…" : "Bind to a channel or formula"} />
        ))}
        {blocks.length > FEW && (
          <details>
            <summary>{blocks.length - FEW} more</summary>
            {blocks.slice(FEW).map((block) => (
              <StopRow key={block.path} block={block} text="Bind…" />
            ))}
          </details>
        )}
      </span>
    </div>
  );
}

/** The step of the data as that of the function, or another one. */
function FixedStep() {
  const own = diagram.value?.dataStep;
  const set = (step: number): void => void setKeys([[["model", "step"], step]], `Step of the function: ${step} s`);
  return (
    <span class="row stop" id="fixed-step">
      {own && (
        <button class="btn small" title="[model] step" onClick={() => set(own)}>
          Step of {plain(own)} s, as the data
        </button>
      )}
      <span class="field small num" style={{ width: "84px" }} title="[model] step">
        <NumberInput
          label="Step of the function"
          placeholder="step"
          own={undefined}
          enter={(value) => {
            if (typeof value === "number") set(value);
          }}
        />
        <u>s</u>
      </span>
    </span>
  );
}

function StopRow({ block, text }: { block: BlockingBlock; text: string }) {
  return (
    <span class="row stop" data-blocking={block.path}>
      <button class="link cut" title={`${block.path}\nShow it in the tree`} onClick={() => reveal(block.path)}>
        <b>{block.path}</b>
      </button>
      <span class="q">{block.type}</span>
      <button
        class="btn small"
        title={`A channel or a formula in place of ${block.path}\n[model] bind`}
        onClick={() => {
          binding.value = block.path;
        }}
      >
        {text}
      </button>
    </span>
  );
}

function Loop({ loop }: { loop: string[] }) {
  return (
    <div class="note warn">
      <Icon name="warning" />
      <span class="grow">
        Algebraic loop:{" "}
        {loop.map((path, k) => (
          <>
            {k > 0 && " → "}
            <button class="link" onClick={() => reveal(path)}>
              {path}
            </button>
          </>
        ))}
        . Insert a Unit Delay into the model, or bind one of its blocks.
        <span class="row">
          <button
            class="btn small"
            onClick={() => {
              binding.value = loop[0]!;
            }}
          >
            Bind to a channel or formula
          </button>
        </span>
      </span>
    </div>
  );
}

function Variables({ own }: { own: ImportedFunction }) {
  const files = textsAt(["model", "parameters"]);
  const missing = own.undefined ?? [];
  const provided = (file: string) =>
    (own.parameters ?? []).filter((each) => each.source.includes(file.split("/").at(-1)!)).length;
  return (
    <>
      <div class="head mid">
        <h2>Variables</h2>
        <span class="sub">{missing.length ? `${missing.length} without a value` : "all have a value"}</span>
        <span class="right">
          <label
            class="btn small"
            title="Scripts (.m), .mat, .sldd, or calibration files with values of variables&#10;[model] parameters"
          >
            <Icon name="plus" />
            File with values
            <input
              type="file"
              multiple
              hidden
              onChange={(event) => addValueFiles([...(event.currentTarget.files ?? [])])}
            />
          </label>
        </span>
      </div>
      {files.length > 0 && (
        <div class="chips">
          {files.map((file) => (
            <span class="chip" title={`[model] parameters: ${file}`}>
              <Icon name="file" kind="q" />
              {file} <i>{provided(file)} used</i>
              <button
                class="link"
                aria-label={`Remove ${file}`}
                onClick={() =>
                  setTexts(
                    ["model", "parameters"],
                    files.filter((each) => each !== file),
                    `${file} no longer gives values`,
                  )
                }
              >
                ×
              </button>
            </span>
          ))}
        </div>
      )}
      <table class="list">
        <thead>
          <tr>
            <th>name</th>
            <th>kind</th>
            <th class="num">value</th>
            <th>from</th>
          </tr>
        </thead>
        <tbody>
          {missing.map((each) => (
            <tr
              key={each.name}
              data-missing={each.name}
              title={`Used by ${each.paths.join(", ")}${each.reason ? `\n${each.reason}` : ""}`}
            >
              <td class="cut">
                <b class="warn">{each.name}</b>
              </td>
              <td class="q">missing</td>
              <td class="num">
                <Value name={each.name} />
              </td>
              <td class="cut">
                <button class="link" onClick={() => reveal(each.paths[0]!)}>
                  {each.paths[0]}
                </button>
                {each.paths.length > 1 && <span class="q"> +{each.paths.length - 1}</span>}
              </td>
            </tr>
          ))}
          {(own.parameters ?? []).map((each) => (
            <tr key={each.name} title={limits(each)}>
              <td class="cut">
                <b>{each.name}</b>
              </td>
              <td class="q">
                {each.kind} {each.shape.join(" × ")}
              </td>
              <td class="num ink">
                {range(each)} <span class="q">{each.unit}</span>
              </td>
              <td class="mono cut" title={each.source}>
                {each.source || "in the block"}
                {each.locked && <span class="q"> locked</span>}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </>
  );
}

/** A value for a variable that no file provides. */
function Value({ name }: { name: string }) {
  return (
    <span class="field small num" style={{ width: "64px" }}>
      <input
        aria-label={`Value of ${name}`}
        placeholder="value"
        inputMode="decimal"
        title={`A number; tables come from files\n[parameters.${name}] initial`}
        onChange={(event) => {
          const value = parseNumber(event.currentTarget.value);
          if (value !== null) void setKeys([[["parameters", name, "initial"], value]], `${name} is ${value}`);
        }}
      />
    </span>
  );
}

function Notes({ own }: { own: ImportedFunction }) {
  const step = own.step ? `the fixed step ${plain(own.step)} s` : "the step of the data";
  const notes = own.notes ?? [];
  return (
    <>
      {own.solver !== undefined && (
        <div class="note">
          <span class="q">?</span>
          <span>
            Runs with {own.solver && `solver ${own.solver} and `}
            {step}.
          </span>
        </div>
      )}
      {notes.length > 0 && (
        <details class="more">
          <summary>
            {notes.length} {notes.length === 1 ? "remark" : "remarks"} on differences from Simulink
          </summary>
          <ul>
            {notes.map((note) => (
              <li>{note}</li>
            ))}
          </ul>
        </details>
      )}
    </>
  );
}
