// Files that are dropped onto the page: stored beside the project.

import { failure, message } from "./store";

/** Store files in the folder of the project; returns the names under which they are stored. */
export async function upload(files: File[]): Promise<string[]> {
  const names: string[] = [];
  for (const file of files) {
    message.value = `Reading ${file.name}`;
    try {
      const answer = await fetch(`/upload/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
      const { file: stored, error } = (await answer.json()) as { file?: string; error?: string };
      if (stored === undefined) failure.value = `${file.name}: ${error}`;
      else names.push(stored);
    } catch {
      failure.value = `${file.name} could not be stored: the connection was lost. Drop it again.`;
    }
  }
  return names;
}

/** The address of a file of the folder, for a link. */
export const address = (name: string): string => `/file/${name.split("/").map(encodeURIComponent).join("/")}`;
