// Settings of the open parameter, of axes that tables share, and of the calibration files.

import { EntryForm } from "../../instruments/entry-form";
import { AddByName, EntryList } from "../../instruments/entry-list";
import { SettingsPanel, type Tab } from "../../instruments/settings-panel";
import { Remove } from "../../instruments/value-field";
import { openEntry, opened, panel } from "../../navigation";
import { directionsOf } from "../../schema";
import { setKeys, settings, valueAt } from "../../settings";
import { open, openName, state } from "../../store";

const TABS: Tab[] = [
  { section: "parameters", title: "Parameter", content: () => <OpenParameter /> },
  {
    section: "axes",
    title: "Shared axes",
    content: () => (
      <EntryList
        section="axes"
        noun="axis"
        empty="Axes that several tables share. Give one a name, its input and its breakpoints; a table refers to it by axis."
      />
    ),
  },
  { section: "calibration", title: "Calibration files", content: () => <EntryForm path={["calibration"]} /> },
];

export const ParameterSettings = () => (
  <SettingsPanel own={panel.parameters} tabs={TABS} label="Settings of parameters" />
);

function OpenParameter() {
  const name = openName.value;
  const inFile = valueAt(["parameters", name]) !== undefined;
  return (
    <>
      <div class="entry-line on">
        <b class="grow cut">{name || "No parameter is open"}</b>
        {inFile && (
          <button
            class="btn small"
            title={`Remove [parameters.${name}] from the project file; values of calibration files stay`}
            onClick={() => setKeys([[["parameters", name], null]], `Removed the settings of ${name}`)}
          >
            Remove
          </button>
        )}
      </div>
      {name && <EntryForm key={name} path={["parameters", name]} directions={directionsOf(name)} />}
      <Others />
    </>
  );
}

/** Sections of parameters that the function does not use, and a line that adds one. */
function Others() {
  const names = Object.keys(settings.value.settings.parameters ?? {});
  const unused =
    state.value.project === null ? [] : names.filter((name) => !state.value.parameters.some((p) => p.name === name));
  return (
    <>
      {unused.map((name) => {
        const isOpen = opened.value.parameters === name;
        return (
          <>
            <div class="entry-line">
              <button
                class="fold grow cut"
                aria-expanded={isOpen}
                onClick={() => openEntry("parameters", isOpen ? 0 : name)}
              >
                <i>{isOpen ? "⌄" : "›"}</i> <b>{name}</b> <span class="tag w">not in use</span>
              </button>
              <Remove
                label={`parameter ${name}`}
                act={() => setKeys([[["parameters", name], null]], `Removed parameter ${name}`)}
              />
            </div>
            {isOpen && <EntryForm path={["parameters", name]} />}
          </>
        );
      })}
      <AddByName
        noun="parameter"
        taken={names}
        holds="parameter"
        add={(name) => {
          openEntry("parameters", name);
          if (state.value.parameters.some((p) => p.name === name)) open(name);
          void setKeys([[["parameters", name], { initial: 0 }]], `Added parameter ${name}`);
        }}
      />
    </>
  );
}
