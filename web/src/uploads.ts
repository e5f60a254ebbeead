// Files from the user's machine, stored beside the project.

import { failure, message } from "./store";

/** Store a file beside the project; returns its name there, null if it is refused. */
export async function upload(file: File): Promise<string | null> {
  message.value = `Reading ${file.name}`;
  try {
    const answer = await fetch(`/upload/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
    const { file: stored, error } = (await answer.json()) as { file?: string; error?: string };
    if (stored !== undefined) return stored;
    failure.value = `${file.name}: ${error}`;
  } catch {
    failure.value = `${file.name} could not be stored: the connection was lost.`;
  }
  return null;
}

/** Let the user choose a file. */
export function pickFile(accept: string, take: (file: File) => unknown): void {
  const field = document.createElement("input");
  field.type = "file";
  field.accept = accept;
  field.onchange = () => { if (field.files?.[0]) take(field.files[0]); };
  field.click();
}
