// The socket: questions with answers, and news that the server pushes. A lost connection is picked up again.

import type { ActivityNews, Questions, StateNews } from "./replies";
import { letInAgain } from "./restart";
import { parseRoute } from "./route";
import { onRenewal, projectId } from "./scope";

export type Question = keyof Questions;

/** What is asked: left out if every detail of the question may be. */
export type Asked<Q extends Question> =
  Record<string, never> extends Questions[Q]["asks"] ? [given?: Questions[Q]["asks"]] : [given: Questions[Q]["asks"]];

/** A reply, with the project and the revision that it is about. */
export interface Reply<Q extends Question> {
  project: string;
  revision: number;
  head: Questions[Q]["head"];
  arrays: Questions[Q]["arrays"];
}

/** A frame: a reply by its `id`, with an `error` if there is none, or news of a topic. */
interface Frame {
  head: {
    id?: number;
    error?: string;
    push?: string;
    project?: string;
    revision?: number;
    arrays: [name: string, size: number][];
  } & object;
  arrays: Record<string, Float32Array>;
}

/** News that the server pushes, by topic. */
interface News {
  state: StateNews;
  activity: ActivityNews;
}

type Listener<Topic extends keyof News = keyof News> = (news: News[Topic]) => void;

const waiting = new Map<number, { resolve: (frame: Frame) => void; reject: (error: Error) => void }>();
const listeners = new Map<string, Listener<never>>();
let socket: WebSocket | null = null;
let count = 0;
let online: (connected: boolean) => void = () => {};

/** Split a frame into its head and its arrays; see `kennfeld.app.frames`. */
export function unpack(frame: ArrayBuffer): Frame {
  const length = new DataView(frame).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length))) as Frame["head"];
  const arrays: Record<string, Float32Array> = {};
  let at = 4 + length;
  for (const [name, size] of head.arrays) {
    arrays[name] = new Float32Array(frame, at, size);
    at += 4 * size;
  }
  return { head, arrays };
}

/** Handle news of a topic. */
export function listen<Topic extends keyof News>(topic: Topic, listener: Listener<Topic>): void {
  listeners.set(topic, listener);
}

/** Connect, and connect again whenever the server comes back. */
export function connect(changed: (connected: boolean) => void): void {
  online = changed;
  open(250);
}

function open(pause: number): void {
  const project = encodeURIComponent(projectId() || parseRoute(location.hash).project);
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const next = new WebSocket(`${scheme}://${location.host}/socket?project=${project}`);
  next.binaryType = "arraybuffer";
  next.onopen = () => {
    socket = next;
    pause = 250;
    online(true);
  };
  next.onmessage = (event: MessageEvent<ArrayBuffer>) => receive(unpack(event.data));
  let opened = false;
  next.addEventListener("open", () => {
    opened = true;
  });
  next.onclose = () => {
    socket = null;
    for (const { reject } of waiting.values()) reject(new Error("The connection to Kennfeld was lost."));
    waiting.clear();
    online(false);
    const again = (): void => void setTimeout(() => open(Math.min(pause * 2, 2000)), pause);
    if (opened) again();
    else void letInAgain().then((accepted) => (accepted ? open(250) : again()), again);
  };
}

function receive(frame: Frame): void {
  const { push, id, error } = frame.head;
  if (push !== undefined) {
    listeners.get(push)?.(frame.head as never);
    return;
  }
  if (id === undefined) return;
  const asked = waiting.get(id);
  waiting.delete(id);
  busy();
  if (error !== undefined) asked?.reject(new Error(error));
  else asked?.resolve(frame);
}

/** Ask a question; the promise fails with the server's message. */
export function ask<Q extends Question>(question: Q, ...[given]: Asked<Q>): Promise<Reply<Q>> {
  return new Promise((resolve, reject) => {
    if (socket === null) {
      reject(new Error("Kennfeld is not connected."));
      return;
    }
    const id = ++count;
    const answered = (frame: Frame) => {
      const { project = "", revision = 0 } = frame.head;
      resolve({ ...frame, project, revision } as unknown as Reply<Q>);
    };
    waiting.set(id, { resolve: answered, reject });
    busy();
    socket.send(JSON.stringify({ id, ask: question, with: given ?? {}, project: projectId() }));
  });
}

let ready = false;

/** Say that the first state has been drawn. */
export function setReady(): void {
  ready = true;
  busy();
}

const isBusy = (): boolean => !ready || waiting.size > 0;
let later: (() => void) | null = null;

function busy(): void {
  document.documentElement.dataset.state = isBusy() ? "busy" : "ready";
  if (!isBusy() && later !== null) requestIdleCallback(doLater);
}

function doLater(): void {
  if (isBusy() || later === null) return; // an answer led to the next question, whose answer comes here again
  const work = later;
  later = null;
  work();
}

/** Do something once the first screen is drawn and nothing is asked any more. */
export function whenIdle(work: () => void): void {
  later = work;
  busy();
}

/** Return a function that sends at most one question at a time; of those that wait only the newest is sent. `flush`
 * sends the one that waits without waiting for the answer to the one before. */
export function newest<T>(send: (value: T) => Promise<unknown>): ((value: T) => void) & { flush: () => void } {
  let running = false;
  let next: { value: T } | null = null;
  onRenewal(() => {
    next = null; // of the project before
  });
  const go = async (value: T) => {
    running = true;
    try {
      await send(value);
    } finally {
      running = false;
      if (next !== null) {
        const { value: later } = next;
        next = null;
        void go(later);
      }
    }
  };
  const put = (value: T): void => {
    if (running) next = { value };
    else void go(value);
  };
  const flush = (): void => {
    const value = next?.value;
    if (next === null) return;
    next = null;
    void send(value as T);
  };
  return Object.assign(put, { flush });
}
