// What the page shows: the server's state, and what only this page knows, such as the open screen.

import { batch, computed, signal } from "@preact/signals";
import { type Asked, ask, type Question, type Reply, setReady } from "./connection";
import { themeChanged } from "./drawing/colours";
import { afterEdit, PendingEdits } from "./pending-edits";
import type { EditedTable, OpenProject, AppState as OpenState, StateNews, ValueEdit } from "./replies";
import { onRenewal, projectId, renew, scoped } from "./scope";
import type { Screen } from "./screen-names";

/** The state of the open project; empty lists as long as it cannot be evaluated. */
export interface AppState extends Omit<Required<OpenState>, "project"> {
  project: OpenProject | null;
}

export { SCREENS, type Screen } from "./screen-names";

const EMPTY: AppState = {
  project: null,
  revision: 0,
  textRevision: 0,
  unsaved: [],
  undo: "",
  redo: "",
  scores: [],
  findings: [],
  code: [],
  job: { state: "idle", message: "", seconds: 0, run: 0, iterations: 0, validates: false },
  waiting: [],
  training: { state: "idle", file: "", seconds: 0, lines: [] },
  terms: { state: "idle", text: "", done: 0, parts: 0, seconds: 0, detail: "" },
  design: { state: "idle", text: "", done: 0, parts: 0, seconds: 0, detail: "" },
  parameters: [],
  freeValues: 0,
  datasets: [],
  criteria: [],
  inputs: [],
  nodes: [],
  runs: [],
  seconds: 0,
  changedOnDisk: [],
  recoverable: false,
  interrupted: false,
  function: { file: "", screen: "formula" },
  excerpt: null,
  reference: { key: "start", title: "start", chosen: false },
};

export const state = signal<AppState>(EMPTY);
export const revision = computed(() => state.value.revision);

/** The state as of the last change of the model: what reads this does not follow every step of a run. */
export const settled = computed(() => {
  void revision.value;
  return state.peek();
});
export const connected = signal(false);
export const screen = signal<Screen>("parameters");
export const openName = scoped("");
export const table = scoped<EditedTable | null>(null);
export const message = scoped("");
export const failure = scoped("");
export const theme = signal(document.documentElement.dataset.theme === "dark" ? "dark" : "light");

/** The selected rectangle of the open table, by x and y index, and the cell that typing changes. */
export interface Selection {
  x: [number, number];
  y: [number, number];
  active: [number, number];
}
export const selection = scoped<Selection>({ x: [0, 0], y: [0, 0], active: [0, 0] });

/** What the values of the open table are compared with, in words. */
export const referenceName = computed(() => table.value?.referenceTitle ?? state.value.reference.title);

export const parameter = computed(() => state.value.parameters.find((p) => p.name === openName.value) ?? null);

let dragging = "";
onRenewal(() => {
  dragging = "";
});

/** Edits are sent when the one before is answered; a question that is to find them has all of them sent before it. */
const AFTER_EDITS = new Set<Question>([
  ...(["undo", "redo", "save", "run", "accept", "set-keys", "set-toml", "apply-fix", "lock-values"] as const),
  ...(["pin-values", "take-values", "add-proposals", "apply-term", "look", "propose-design", "reload"] as const),
  ...(["discard", "export", "write-unit", "write-calibration", "open", "show", "demo", "new"] as const),
]);
const sendEdits: (() => void)[] = [];

/** Call a function, which sends the edits that wait, before a question that is to find them. */
export const beforeCommands = (send: () => void): void => void sendEdits.push(send);

/** What a second click asks again while the first one is being answered; it is asked once. */
const ONCE = new Set<Question>([
  ...(["run", "save", "accept", "apply-fix", "take-values", "add-proposals", "apply-term", "look"] as const),
  ...(["propose-design", "export", "export-design", "write-unit", "write-calibration", "open", "demo"] as const),
  ...(["new", "add-files", "add-functions", "new-function", "new-surrogate", "train-surrogate"] as const),
  "convert-function",
]);
const underway = new Map<string, Promise<unknown>>();

let changing = 0;

/** True while a command is not answered: what it changes is not in the state yet. */
export const isChanging = (): boolean => changing > 0;

/**
 * Ask, and show the server's message if it refuses. What is about a project that the page does not show any more, or
 * about values before the present ones, is dropped.
 */
export function request<Q extends Question>(question: Q, ...given: Asked<Q>): Promise<Reply<Q> | null> {
  if (AFTER_EDITS.has(question)) for (const send of sendEdits) send();
  if (!ONCE.has(question)) return answered(question, ...given);
  const key = JSON.stringify([question, given, projectId()]);
  const first = underway.get(key) as Promise<Reply<Q> | null> | undefined;
  const reply = first ?? answered(question, ...given).finally(() => underway.delete(key));
  underway.set(key, reply);
  return reply;
}

async function answered<Q extends Question>(question: Q, ...given: Asked<Q>): Promise<Reply<Q> | null> {
  const own = projectId();
  const changes = AFTER_EDITS.has(question) || question === "set-values" || question === "set-text";
  if (changes) changing++;
  try {
    const reply = await ask(question, ...given);
    if (!OPENING.has(question) && (own !== projectId() || reply.project !== own || isOlder(reply))) return null;
    failure.value = "";
    return reply;
  } catch (error) {
    if (own === projectId()) failure.value = (error as Error).message;
    return null;
  } finally {
    if (changes) changing--;
  }
}

const OPENING = new Set<Question>(["open", "show", "demo", "new", "projects", "forget"]);

const isOlder = (reply: { revision: number }): boolean => reply.revision < state.peek().revision;

/** What ended, and how: `Run 2: converged.` */
export function jobTitle({ job, runs }: Pick<AppState, "job" | "runs">): string {
  if (job.validates) return job.state === "validated" ? "Cross-validation:" : `Cross-validation: ${job.state}.`;
  // a run that failed has no number
  return job.state === "failed" ? "The run failed." : `Run ${runs.length}: ${job.state}.`;
}

/** Why nothing can be calibrated or evaluated; null if it can. */
export const blocking = computed(() => state.value.findings.find((each) => each.severity === "error") ?? null);

export const isRunning = (job: AppState["job"]): boolean => job.state === "running" || job.state === "stopping";

/** Take over the state that the server pushed. */
export function takeState(news: StateNews): void {
  const next: AppState = { ...EMPTY, ...news.state };
  const before = revision.value;
  const same = (next.project?.id ?? "") === projectId();
  if (same && isRunning(state.value.job) && !isRunning(next.job))
    message.value = `${jobTitle(next)} ${next.job.message}`;
  batch(() => {
    renew(next.project?.id ?? "");
    state.value = next;
    if (!next.parameters.some((p) => p.name === openName.value))
      openName.value = (next.parameters.find((p) => p.kind !== "rbf") ?? next.parameters[0])?.name ?? "";
  });
  if (revision.value !== before && !dragging) void loadTable();
  setReady();
}

export async function loadTable(): Promise<void> {
  if (!openName.value) {
    table.value = null;
    return;
  }
  const reply = await request("table", { name: openName.value });
  if (reply === null || reply.head.table.name !== openName.value) return;
  // answers come in the order of the questions: edits that are not answered yet are not in it
  const own = reply.head.table;
  const next = { ...own, values: pending.over(own.name, own.values) };
  if (JSON.stringify(next) !== JSON.stringify(table.value)) table.value = next;
}

export function open(name: string): void {
  openName.value = name;
  selection.value = { x: [0, 0], y: [0, 0], active: [0, 0] };
  void loadTable();
}

/** Undo or redo, and say what. */
export async function move(direction: "undo" | "redo"): Promise<void> {
  const reply = await request(direction);
  if (reply?.head.title) message.value = `${direction === "undo" ? "Undone" : "Done again"}: ${reply.head.title}`;
}

export function toggleTheme(): void {
  theme.value = theme.value === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = theme.value;
  themeChanged();
}

const pending = new PendingEdits();
onRenewal(() => pending.clear());

/** Edit values of the open table: shown at once, and sent in the order of the edits. */
function edit(own: ValueEdit): void {
  if (table.value === null) return;
  pending.add(own);
  table.value = { ...table.value, values: afterEdit(table.value.values, own) };
  message.value = own.title;
  dragging = own.drag ?? "";
  send();
}

function send(): void {
  const next = pending.take();
  if (next !== null) void post(next);
}

async function post(own: ValueEdit): Promise<void> {
  const reply = await request("set-values", own);
  pending.answered();
  if (reply === null) void loadTable(); // it was refused: show what is there
  send();
}

beforeCommands(() => {
  for (const each of pending.takeAll()) void post(each);
});

/** Set values of the open table. `drag` joins the moves of one drag. */
export function setValues(cells: number[], values: number[], title: string, drag = ""): void {
  if (table.value !== null) edit({ name: table.value.name, cells, values, title, kind: "set", drag });
}

/** Add an amount to values of the open table, or multiply them by it. */
export function changeValues(cells: number[], kind: "add" | "scale", amount: number, title: string): void {
  if (table.value !== null) edit({ name: table.value.name, cells, title, kind, amount });
}

export function endDrag(): void {
  if (dragging) void loadTable();
  dragging = "";
}
