// The socket: questions with answers, and news that the server pushes. A lost connection is picked up again.

import { letInAgain } from "./restart";

export interface Reply {
  head: Record<string, unknown>;
  arrays: Record<string, Float32Array>;
}

type Listener = (reply: Reply) => void;

const waiting = new Map<number, { resolve: Listener; reject: (error: Error) => void }>();
const listeners = new Map<string, Listener>();
let socket: WebSocket | null = null;
let count = 0;
let online: (connected: boolean) => void = () => {};

/** Split a frame into its head and its arrays; see `kennfeld.app.frames`. */
export function unpack(frame: ArrayBuffer): Reply {
  const length = new DataView(frame).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length))) as Record<string, unknown>;
  const arrays: Record<string, Float32Array> = {};
  let at = 4 + length;
  for (const [name, size] of head.arrays as [string, number][]) {
    arrays[name] = new Float32Array(frame, at, size);
    at += 4 * size;
  }
  return { head, arrays };
}

/** Handle news of a topic. */
export function listen(topic: string, listener: Listener): void {
  listeners.set(topic, listener);
}

/** Connect, and connect again whenever the server comes back. */
export function connect(changed: (connected: boolean) => void): void {
  online = changed;
  open(250);
}

function open(pause: number): void {
  const next = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
  next.binaryType = "arraybuffer";
  next.onopen = () => {
    socket = next;
    pause = 250;
    online(true);
  };
  next.onmessage = (event: MessageEvent<ArrayBuffer>) => receive(unpack(event.data));
  let opened = false;
  next.addEventListener("open", () => { opened = true; });
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

function receive(reply: Reply): void {
  const topic = reply.head.push as string | undefined;
  if (topic !== undefined) {
    listeners.get(topic)?.(reply);
    return;
  }
  const id = reply.head.id as number;
  const asked = waiting.get(id);
  waiting.delete(id);
  busy();
  if (reply.head.error !== undefined) asked?.reject(new Error(reply.head.error as string));
  else asked?.resolve(reply);
}

/** Ask a question; the promise fails with the server's message. */
export function ask(question: string, given: Record<string, unknown> = {}): Promise<Reply> {
  return new Promise((resolve, reject) => {
    if (socket === null) {
      reject(new Error("Kennfeld is not connected."));
      return;
    }
    const id = ++count;
    waiting.set(id, { resolve, reject });
    busy();
    socket.send(JSON.stringify({ id, ask: question, with: given }));
  });
}

let ready = false;

/** Say that the first state has been drawn. */
export function setReady(): void {
  ready = true;
  busy();
}

function busy(): void {
  document.documentElement.dataset.state = ready && waiting.size === 0 ? "ready" : "busy";
}

/** Return a function that sends at most one question at a time; of those that wait only the newest is sent. */
export function newest<T>(send: (value: T) => Promise<unknown>): (value: T) => void {
  let running = false;
  let next: { value: T } | null = null;
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
  return (value) => {
    if (running) next = { value };
    else void go(value);
  };
}
