// Files that are dropped onto the page: stored beside the project.

import { showUpload } from "./activity";
import { significant } from "./drawing/numbers";
import { projectId } from "./scope";
import { failure, message } from "./store";

/** Store files in the folder of the project; returns the names under which they are stored. */
export async function upload(files: File[]): Promise<string[]> {
  const names: string[] = [];
  for (const file of files) {
    message.value = `Reading ${file.name}`;
    const answer = await put(file, files.length > 1 ? `, ${files.indexOf(file) + 1} of ${files.length} files` : "");
    if (answer === null) break;
    if (answer.file === undefined) failure.value = `${file.name}${answer.error}`;
    else names.push(answer.file);
  }
  showUpload(null);
  return names;
}

const LOST = " could not be stored: the connection was lost. Drop it again.";

/** Store a file, and show how much of it is stored; null if the user has stopped it. */
function put(file: File, which: string): Promise<{ file?: string; error?: string } | null> {
  return new Promise((resolve) => {
    const sent = new XMLHttpRequest(); // fetch does not say how much of a body is sent
    sent.open("PUT", inProject(`/upload/${encodeURIComponent(file.name)}`));
    const show = (share: number): void =>
      showUpload({ text: `Storing ${file.name}, ${significant(file.size / 1e6, 3)} MB${which}`, share }, () =>
        sent.abort(),
      );
    sent.upload.onprogress = ({ loaded }) => show(loaded / Math.max(1, file.size));
    sent.onabort = () => resolve(null);
    sent.onerror = () => resolve({ error: LOST });
    sent.onload = () => {
      try {
        const { file: stored, error } = JSON.parse(sent.responseText) as { file?: string; error?: string };
        resolve(stored === undefined ? { error: `: ${error}` } : { file: stored });
      } catch {
        resolve({ error: LOST });
      }
    };
    show(0);
    sent.send(file);
  });
}

const OF_FOLDERS = /\.(esdl|app)$/i; // what is taken of a folder: an ASCET project also holds diagrams and settings
const MOST = 3000; // files of a folder

/** The files of a drop; of folders, those of ASCET projects within them. */
export async function droppedFiles(event: DragEvent): Promise<File[]> {
  const entries = [...(event.dataTransfer?.items ?? [])].map((item) => item.webkitGetAsEntry?.() ?? null);
  const files = [...(event.dataTransfer?.files ?? [])].filter(
    (file) => !entries.some((entry) => entry?.isDirectory && entry.name === file.name),
  );
  for (const entry of entries) if (entry?.isDirectory) await collect(entry as FileSystemDirectoryEntry, files);
  if (files.length === 0 && entries.some((entry) => entry?.isDirectory))
    failure.value = "The folder has no ESDL files (.esdl, .app).";
  return files;
}

async function collect(folder: FileSystemDirectoryEntry, files: File[]): Promise<void> {
  const reader = folder.createReader();
  for (;;) {
    // a reader returns some entries at a time
    const entries = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (entries.length === 0) return;
    for (const entry of entries) {
      if (files.length >= MOST) return;
      if (entry.isDirectory) await collect(entry as FileSystemDirectoryEntry, files);
      else if (OF_FOLDERS.test(entry.name))
        files.push(await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject)));
    }
  }
}

/** An address of the server, about the project that the page shows. */
export const inProject = (path: string): string => `${path}?project=${encodeURIComponent(projectId())}`;

/** The address of a file of the folder, for a link. */
export const address = (name: string): string =>
  inProject(`/file/${name.split("/").map(encodeURIComponent).join("/")}`);
