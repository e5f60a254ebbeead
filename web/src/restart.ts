// A restarted server: the page proves that it was open before, and takes up its project and its unsaved edits again.

import { signal } from "@preact/signals";

/** True if the server at this address does not know the page: it has to be opened anew. */
export const foreign = signal(false);

const KEY = document.querySelector<HTMLMetaElement>("meta[name=again]")?.content ?? "";

const hex = (bytes: ArrayBuffer): string =>
  [...new Uint8Array(bytes)].map((byte) => byte.toString(16).padStart(2, "0")).join("");

async function proof(side: string, text: string): Promise<string> {
  const encode = (value: string) => new TextEncoder().encode(value);
  const key = await crypto.subtle.importKey("raw", encode(KEY), { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  return hex(await crypto.subtle.sign("HMAC", key, encode(`${side}:${location.port}:${text}`)));
}

/** Ask the server for its proof and a challenge; null if nothing answers. */
function challenge(nonce: string): Promise<{ challenge: string; proof: string } | null> {
  return new Promise((resolve) => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/again`);
    socket.onopen = () => socket.send(JSON.stringify({ nonce }));
    socket.onmessage = (event: MessageEvent<string>) => {
      resolve(JSON.parse(event.data));
      socket.close();
    };
    socket.onclose = () => resolve(null);
  });
}

/** Get a cookie of a server that was restarted, see `kennfeld.app.server.restart`; true if it gives one. */
export async function letInAgain(): Promise<boolean> {
  if (!KEY || crypto.subtle === undefined) return false;
  const nonce = hex(crypto.getRandomValues(new Uint8Array(32)).buffer);
  const answer = await challenge(nonce);
  if (answer === null) return false; // nothing answers yet
  foreign.value = answer.proof !== (await proof("server", nonce));
  if (foreign.value) return false;
  const own = { challenge: answer.challenge, proof: await proof("page", answer.challenge) };
  const accepted = await fetch("/again", { method: "POST", body: JSON.stringify(own) }).then(
    (reply) => reply.ok,
    () => false,
  );
  foreign.value = !accepted;
  return accepted;
}
