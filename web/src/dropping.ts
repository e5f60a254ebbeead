// Files that are dropped anywhere: each is added to the project as what it is. The browser never leaves the page for one.

import { projectFrom } from "./projects";
import { message, request, screen, state } from "./store";
import { droppedFiles, upload } from "./uploads";

const KINDS: Record<string, string> = {
  recording: "recording",
  function: "function",
  program: "function",
  calibration: "file with values",
  description: "description of labels",
  database: "bus database",
};

/** Store files beside the project, and add each as what it is: a dataset, the function, or initial values. */
export async function addFiles(files: File[]): Promise<void> {
  const names = await upload(files);
  if (names.length === 0) return;
  const reply = await request("add-files", { files: names });
  if (reply === null) return;
  const added = Object.entries(reply.head.kinds).map(([name, kind]) => `${name} (${KINDS[kind] ?? kind})`);
  message.value = `Added ${added.join(", ")}`;
}

const hasFiles = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;

/** Take what is dropped on a screen that does nothing else with it. */
export function takeDrops(): void {
  addEventListener("dragover", (event) => {
    if (hasFiles(event)) event.preventDefault();
  });
  addEventListener("drop", (event) => {
    if (!hasFiles(event) || event.defaultPrevented) return;
    event.preventDefault();
    void droppedFiles(event).then((files) => {
      if (files.length === 0) return;
      if (state.value.project === null || screen.value === "start") projectFrom(files);
      else void addFiles(files);
    });
  });
}
