// Settings of the function: its file and step, what a Simulink model needs, and the files of data-driven models.

import { useSignal } from "@preact/signals";
import { EntryForm, TableForm } from "../../instruments/entry-form";
import { Segment } from "../../fields";
import { panel } from "../../navigation";

const TITLES: Record<string, string> = { model: "Model", surrogates: "Surrogates" };

export function FunctionSettings() {
  const own = panel.function;
  const section = own.value || "model";
  const open = useSignal(true);
  const isOpen = open.value || own.value !== "";
  return (
    <div class="function-settings">
      <div class="head mid">
        <button class="fold" aria-expanded={isOpen} onClick={() => { open.value = !isOpen; own.value = ""; }}><i>{isOpen ? "⌄" : "›"}</i> <h2>Settings</h2></button>
        <span class="right"><Segment label="Settings of the function" options={Object.values(TITLES)} chosen={TITLES[section]!} choose={(title) => { own.value = Object.keys(TITLES).find((name) => TITLES[name] === title)!; }} /></span>
      </div>
      {isOpen && (section === "model" ? <EntryForm path={["model"]} /> : <TableForm section="surrogates" />)}
    </div>
  );
}
