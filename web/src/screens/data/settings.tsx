// Settings of the data: all keys of the datasets, channels of inputs, calculated channels and units.

import { TableForm } from "../../instruments/entry-form";
import { EntryList } from "../../instruments/entry-list";
import { SettingsPanel, type Tab } from "../../instruments/settings-panel";
import { panel } from "../../navigation";

const TABS: Tab[] = [
  {
    section: "dataset",
    title: "Datasets",
    content: () => (
      <EntryList
        section="dataset"
        noun="dataset"
        empty="Recordings to calibrate with. Drop files onto the page, or name them here."
      />
    ),
  },
  { section: "channels", title: "Channels", content: () => <TableForm section="channels" /> },
  { section: "calculated", title: "Calculated", content: () => <TableForm section="calculated" /> },
  { section: "units", title: "Units", content: () => <TableForm section="units" /> },
];

export const DataSettings = () => <SettingsPanel own={panel.data} tabs={TABS} label="Settings of the data" />;
