// Settings of the function: its file and step, what a model needs, the functions that it calls, and the files of
// data-driven models.

import { Segment } from "../../fields";
import { EntryForm, TableForm } from "../../instruments/entry-form";
import { panel } from "../../navigation";
import { Fold } from "./fold";

const TITLES: Record<string, string> = { model: "Model", functions: "Functions", surrogates: "Surrogates" };

export function FunctionSettings() {
  const own = panel.function;
  const section = own.value || "model";
  return (
    <Fold
      title="Settings"
      sub="of the function"
      name="settings"
      forced={own.value !== ""}
      close={() => {
        own.value = "";
      }}
    >
      <div class="function-settings">
        <Segment
          label="Settings of the function"
          options={Object.values(TITLES)}
          chosen={TITLES[section]!}
          choose={(title) => {
            own.value = Object.keys(TITLES).find((name) => TITLES[name] === title)!;
          }}
        />
        {section === "model" ? <EntryForm path={["model"]} /> : <TableForm key={section} section={section} />}
      </div>
    </Fold>
  );
}
