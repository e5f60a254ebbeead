// Blocks that a channel or a formula replaces: those that are bound, and the field that binds another one.

import { effect } from "@preact/signals";
import { useLayoutEffect, useRef } from "preact/hooks";
import { newest } from "../../connection";
import { significant } from "../../drawing/numbers";
import { Icon } from "../../icons";
import type { ReadChannel } from "../../replies";
import { scoped } from "../../scope";
import { setKeys } from "../../settings";
import { request } from "../../store";
import { diagram } from "./source";

export const binding = scoped(""); // path of the block that is being bound
const text = scoped("");
const reads = scoped<{ channels: ReadChannel[]; problem: string }>({ channels: [], problem: "" });

const check = newest(async (formula: string) => {
  const reply = await request("formula-reads", { text: formula });
  if (reply !== null) reads.value = reply.head;
});

effect(() => {
  if (binding.value !== "" && text.value.trim()) check(text.value);
});
effect(() => {
  text.value = diagram.value?.bind[binding.value] ?? "";
});

/** The field that binds the block `binding`. */
export function Binding() {
  const field = useRef<HTMLInputElement>(null);
  const path = binding.value;
  useLayoutEffect(() => {
    field.current?.focus();
  }, [path]);
  if (path === "") return null;
  const usable = text.value.trim() !== "" && reads.value.problem === "";
  const apply = () => {
    const formula = text.value.trim();
    if (!usable) return;
    binding.value = ""; // which empties the field
    void setKeys([[["model", "bind", path], formula]], `Bound ${path} to ${formula}`);
  };
  return (
    <form
      class="binding pad"
      onSubmit={(event) => {
        event.preventDefault();
        apply();
      }}
    >
      <label class="q" for="binding">
        Formula or channel in place of <b class="ink">{path}</b>
      </label>
      <span class={`field mono ${text.value.trim() && reads.value.problem ? "bad" : ""}`}>
        <input
          id="binding"
          ref={field}
          value={text.value}
          placeholder="0.15 * (t_wall - 20)"
          autocomplete="off"
          spellcheck={false}
          title={`A channel, or a formula over channels\n[model] bind = { "${path}" = "..." }`}
          onInput={(event) => {
            text.value = event.currentTarget.value;
          }}
          onKeyDown={(event) => {
            if (event.key === "Escape") binding.value = "";
          }}
        />
      </span>
      <Reads />
      <span class="row">
        <button class="btn small primary" type="submit" disabled={!usable}>
          Bind
        </button>
        <button
          class="btn small"
          type="button"
          onClick={() => {
            binding.value = "";
          }}
        >
          Cancel
        </button>
      </span>
    </form>
  );
}

/** What the formula reads. */
function Reads() {
  const { channels, problem } = reads.value;
  if (text.value.trim() === "")
    return <p class="q">Nothing is guessed: name the channel that the block would deliver, or calculate it.</p>;
  if (problem)
    return (
      <p class="bad" role="alert">
        {problem.replace(/^[,: ]+/, "")}
      </p>
    );
  return (
    <>
      {channels.map((each) =>
        each.known ? (
          <p key={each.name}>
            <Icon name="done" kind="good" /> reads the channel <b class="mono">{each.name}</b>
            {each.least !== null && `, ${significant(each.least)} … ${significant(each.greatest!)}`}
          </p>
        ) : (
          <p key={each.name} class="warn">
            <Icon name="warning" /> no recording has the channel <b class="mono">{each.name}</b> yet. {each.guess}
          </p>
        ),
      )}
    </>
  );
}

/** The blocks that are bound. */
export function Bindings() {
  const all = Object.entries(diagram.value?.bind ?? {});
  if (all.length === 0) return null;
  return (
    <table class="list" aria-label="Bindings">
      <tbody>
        {all.map(([path, formula]) => (
          <tr key={path}>
            <td>
              <Icon name="link" kind="acc" /> <b>{path}</b>
            </td>
            <td class="mono">{formula}</td>
            <td class="num">
              <button
                class="btn bare small"
                onClick={() => {
                  binding.value = path;
                }}
              >
                Change
              </button>
              <button
                class="btn bare small"
                aria-label={`Remove the binding of ${path}`}
                title="Use the block again"
                onClick={() => {
                  void setKeys([[["model", "bind", path], null]], `${path} is no longer bound`);
                }}
              >
                ×
              </button>
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
