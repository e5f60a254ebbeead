// Everything that can be done by name: the command palette and the shortcuts both use this list.

import { signal } from "@preact/signals";
import { accept } from "./comparison";
import { copiedOnScreen, take, WAYS } from "./copying";
import { allKeys, jump, panel, togglePanel } from "./navigation";
import { outcome, resume, run, running, view } from "./runs";
import { save } from "./saving";
import { blocking, isChanging, move, open, request, type Screen, screen, state, toggleTheme } from "./store";
import { inProject } from "./uploads";

export interface Command {
  title: string;
  hint?: string;
  keys: string[];
  run: () => void;
  enabled?: () => boolean;
}

export const overlay = signal<"" | "palette" | "keys" | "errors">("");

const screens: [Screen, string, number | string][] = [
  ["data", "Data", 1],
  ["function", "Function", 2],
  ["parameters", "Parameters", 3],
  ["optimization", "Optimization", 4],
  ["results", "Results", 5],
  ["plots", "Plots", 6],
  ["files", "Files", 7],
  ["missing", "Missing terms", 8],
  ["design", "Measure next", 9],
  ["control-unit", "Control unit", "E"],
];

/** The titles of the screens. */
export const TITLES: Record<string, string> = {
  ...Object.fromEntries(screens.map(([name, title]) => [name, title])),
  start: "Projects",
};

export const COMMANDS: Command[] = [
  ...screens.map(
    ([name, title, key]): Command => ({
      title: `Go to ${title}`,
      keys: ["Alt", String(key)],
      run: () => {
        screen.value = name;
      },
    }),
  ),
  {
    title: "Projects",
    keys: [],
    run: () => {
      screen.value = "start";
    },
  },
  { title: "Run the calibration", keys: ["F5"], run, enabled: () => !running() && blocking.value === null },
  { title: "Stop and keep the best", keys: ["Shift", "F5"], run: () => void request("stop"), enabled: running },
  {
    title: "Undo",
    keys: ["Ctrl", "Z"],
    run: () => void move("undo"),
    enabled: () => state.value.undo !== "" || state.value.waiting.length > 0 || isChanging(),
  },
  { title: "Redo", keys: ["Ctrl", "Y"], run: () => void move("redo"), enabled: () => state.value.redo !== "" },
  {
    title: "Save",
    keys: ["Ctrl", "S"],
    run: () => void save(),
    enabled: () => state.value.unsaved.length > 0 || isChanging(),
  },
  {
    title: "Export",
    keys: ["Ctrl", "E"],
    run: () => {
      screen.value = "results";
    },
  },
  { title: "Accept the last run", keys: [], run: () => accept(), enabled: () => state.value.runs.length > 0 },
  {
    title: "Resume an interrupted run",
    keys: [],
    run: resume,
    enabled: () => !running() && outcome.value.resumable !== "",
  },
  {
    title: "Cross-validate",
    keys: [],
    run: () => {
      screen.value = "optimization";
      view.value = "cross-validation";
    },
    enabled: () => state.value.project !== null,
  },
  {
    title: "Compare, merge or convert calibration files",
    keys: [],
    run: () => {
      screen.value = "files";
    },
  },
  {
    title: "Download the folder as ZIP",
    keys: [],
    run: () => {
      location.assign(inProject("/project.zip"));
    },
    enabled: () => state.value.project !== null,
  },
  {
    title: "Settings of this screen",
    keys: ["Ctrl", ","],
    run: togglePanel,
    enabled: () => state.value.project !== null && screen.value in panel,
  },
  {
    title: "Errors of all criteria",
    keys: ["Alt", "R"],
    run: () => {
      overlay.value = "errors";
    },
    enabled: () => state.value.scores.length > 0,
  },
  { title: "Light or dark", keys: [], run: toggleTheme },
  {
    title: "Keys",
    keys: ["?"],
    run: () => {
      overlay.value = "keys";
    },
  },
];

/** All commands, one for each parameter, and one for each key of the project file. */
export function searchable(): Command[] {
  return [
    ...actions(),
    ...(state.value.project === null ? [] : allKeys()).map(
      ({ section, key }): Command => ({
        title: key.name ? `${section}.${key.name}` : section,
        hint: key.help,
        keys: [],
        run: () => jump(section, key.name),
      }),
    ),
  ];
}

/** Copy or save a picture or a table of the screen. */
function copies(): Command[] {
  return copiedOnScreen()
    .filter((own) => own.label !== "")
    .flatMap((own) =>
      WAYS[own.kind].map(
        ([way, text]): Command => ({ title: `${text}: ${own.label}`, keys: [], run: () => void take(own, way) }),
      ),
    );
}

function actions(): Command[] {
  return [
    ...COMMANDS.filter((command) => command.enabled?.() ?? true),
    ...copies(),
    ...state.value.parameters.map(
      (p): Command => ({
        title: `Open ${p.name}`,
        keys: [],
        run: () => {
          open(p.name);
          screen.value = "parameters";
        },
      }),
    ),
  ];
}

function matches(command: Command, event: KeyboardEvent): boolean {
  const key = command.keys.at(-1);
  if (key === undefined) return false;
  const has = (name: string) => command.keys.slice(0, -1).includes(name);
  const control = event.ctrlKey || event.metaKey;
  return (
    event.key.toLowerCase() === key.toLowerCase() &&
    control === has("Ctrl") &&
    event.altKey === has("Alt") &&
    (key === "?" || event.shiftKey === has("Shift"))
  );
}

/** Have a field report what was typed into it, which it does when it is left: a run or a save is to find it. */
function enterField(field: HTMLElement): void {
  if (!field.matches("input, textarea")) return;
  field.blur();
  field.focus({ preventScroll: true });
}

/** Handle a key anywhere on the page. */
export function shortcut(event: KeyboardEvent): void {
  const typing = (event.target as HTMLElement).closest("input, textarea, [contenteditable=true]") !== null;
  if (document.querySelector("dialog[open]") !== null) return; // keys belong to the dialog
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "k")
    overlay.value = overlay.value === "palette" ? "" : "palette";
  else {
    const command = COMMANDS.find((each) => matches(each, event));
    const plainKey = !event.ctrlKey && !event.metaKey && !event.altKey && !/^F\d/.test(event.key);
    const editing = typing && (plainKey || ["z", "y"].includes(event.key.toLowerCase()));
    if (command === undefined || editing) return;
    if (typing) enterField(event.target as HTMLElement);
    if (!(command.enabled?.() ?? true)) return;
    command.run();
  }
  event.preventDefault();
}
