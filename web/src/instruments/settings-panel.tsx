// A pane with the settings of some sections of the project file, one at a time.

import type { Signal } from "@preact/signals";
import type { JSX } from "preact";
import { Segment } from "../fields";

export interface Tab {
  section: string;
  title: string;
  content: () => JSX.Element;
}

/** The open tab is the section that `own` names; nothing is shown if it names none of them. */
export function SettingsPanel({ own, tabs, label }: { own: Signal<string>; tabs: Tab[]; label: string }) {
  const open = tabs.find((tab) => tab.section === own.value);
  if (open === undefined) return null;
  return (
    <section class="pane settings-panel" aria-label={label}>
      <div class="head">
        <Segment
          label={label}
          options={tabs.map((tab) => tab.title)}
          chosen={open.title}
          choose={(title) => {
            own.value = tabs.find((tab) => tab.title === title)!.section;
          }}
        />
        <span class="right">
          <button
            class="btn bare small"
            title="Close the settings"
            aria-label="Close the settings"
            onClick={() => {
              own.value = "";
            }}
          >
            ×
          </button>
        </span>
      </div>
      <div class="items" key={open.section}>
        {open.content()}
      </div>
    </section>
  );
}

/** Opens and closes the settings of a screen; `first` is the section that it opens. */
export function SettingsButton({
  own,
  first,
  label = "Settings",
}: {
  own: Signal<string>;
  first: string;
  label?: string;
}) {
  const isOpen = own.value !== "";
  return (
    <button
      class="chip"
      data-settings={first}
      aria-pressed={isOpen}
      title={`${label}: every key of the project file, with its meaning (Ctrl+,)`}
      onClick={() => {
        own.value = isOpen ? "" : first;
      }}
    >
      {label}
    </button>
  );
}
