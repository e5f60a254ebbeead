// The data: files and their use, channels and what the function reads of them, and how both look.

import { Footer, Key } from "../frame";
import { panel } from "../navigation";
import { ChannelTable } from "./data/channel-table";
import { FileTable } from "./data/file-table";
import { Preview, SidePane } from "./data/preview";
import { DataSettings } from "./data/settings";

export function Data() {
  return (
    <>
      <main class={`data ${panel.data.value ? "open" : ""}`}>
        <FileTable />
        <ChannelTable />
        <Preview />
        <SidePane />
        <DataSettings />
      </main>
      <Footer>
        <Key keys={["↑", "↓"]} text="row" />
        <Key keys={["t", "v", "o"]} text="training, test, off" />
        <Key keys={["m"]} text="map" />
        <Key keys={["Shift", "←", "→"]} text="shift a sample" />
        <Key keys={["F8"]} text="message" />
      </Footer>
    </>
  );
}
