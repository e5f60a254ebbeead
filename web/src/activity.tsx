// What takes a while: a line on every screen that says what is done, how much of it, and stops it.

import { effect, signal } from "@preact/signals";
import { listen } from "./connection";
import type { ActivityNews } from "./replies";
import { onRenewal } from "./scope";
import { failure, request, screen, state } from "./store";

const QUICK = 400; // ms; what takes less is not worth a line

const reported = signal<ActivityNews>({ text: "", share: null });
const uploading = signal<ActivityNews | null>(null);
const shown = signal(false);
const stopping = signal(false);
const began = signal(0);
const now = signal(0);

const present = (): ActivityNews => uploading.value ?? reported.value;
let stopUpload: (() => void) | null = null;
let timer = 0;

effect(() => {
  const busy = present().text !== "";
  clearInterval(timer);
  if (busy) {
    if (began.peek() === 0) began.value = now.value = Date.now();
    timer = window.setInterval(() => {
      now.value = Date.now();
      shown.value = now.value - began.peek() >= QUICK;
    }, QUICK / 2);
  } else {
    began.value = 0;
    shown.value = stopping.value = false;
  }
});

listen("activity", (news: ActivityNews) => {
  reported.value = news;
});
onRenewal(() => {
  reported.value = { text: "", share: null };
});

/** Show how much of a file is stored; null at the end. `stop` is called if the user stops it. */
export function showUpload(news: ActivityNews | null, stop: (() => void) | null = null): void {
  uploading.value = news;
  stopUpload = stop;
}

async function stop(): Promise<void> {
  stopping.value = true;
  if (uploading.value !== null) stopUpload?.();
  else
    await fetch("/stop-activity", { method: "POST" }).catch(() => {
      failure.value = "The connection to Kennfeld was lost.";
    });
}

/** The line; nothing if nothing takes a while. */
export function ActivityNote() {
  return (
    <>
      {shown.value && <PresentActivity />}
      <Training />
      {state.value.interrupted && (
        <div class="note warn" id="interrupted">
          <span class="grow">The recordings were not read, as you stopped it. Screens show what they can without.</span>
          <button class="btn small" onClick={() => request("reload")}>
            Read them
          </button>
        </div>
      )}
    </>
  );
}

function PresentActivity() {
  const { text, share } = present();
  const seconds = Math.round((now.value - began.value) / 1000);
  return (
    <div class="note activity" id="activity">
      <span class="grow cut">
        {text}
        {seconds > 1 && <span class="q">, {seconds} s</span>}
      </span>
      <progress aria-label={text} value={share ?? undefined} />
      <button class="btn small" id="stop-activity" disabled={stopping.value} onClick={() => void stop()}>
        {stopping.value ? "Stopping after this file" : "Stop"}
      </button>
    </div>
  );
}

/** A training that runs while the user looks at another screen than the function, which shows it in its place. */
function Training() {
  const { training } = state.value;
  if (training.state !== "running" || screen.value === "function") return null;
  return (
    <div class="note activity" id="training">
      <span class="grow cut">
        Training {training.file}, {training.seconds.toFixed(0)} s. <span class="q">{training.lines.at(-1)}</span>
      </span>
      <progress aria-label={`Training ${training.file}`} />
      <button class="btn small" onClick={() => request("stop-training")}>
        Stop
      </button>
    </div>
  );
}
