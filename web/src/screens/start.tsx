// The start: recent projects, the demos, and a project file by its path.

import { useSignal } from "@preact/signals";
import { computed, effect, signal } from "@preact/signals";
import { Footer } from "../frame";
import { Icon } from "../icons";
import { newFrom } from "./function/source";
import { request, screen, state, type Screen } from "../store";
import { pickFile } from "../uploads";

interface Known { recent: { path: string; name: string; folder: string }[]; demos: { name: string; title: string }[] }
const known = signal<Known>({ recent: [], demos: [] });

const openPath = computed(() => state.value.project?.path ?? "");

effect(() => {
  void openPath.value;
  if (screen.value === "start") void request("projects").then((reply) => { if (reply !== null) known.value = reply.head as unknown as Known; });
});

async function openProject(question: string, given: Record<string, unknown>, next: Screen = "parameters"): Promise<void> {
  if ((await request(question, given)) !== null) screen.value = next;
}

export function Start() {
  const path = useSignal("");
  const name = useSignal("");
  return (
    <>
      <main class="start" onDragOver={(event) => event.preventDefault()} onDrop={(event) => { event.preventDefault(); const [file] = event.dataTransfer?.files ?? []; if (file && /\.(kf|slx|mdl)$/i.test(file.name)) void newFrom(file); }}>
        <section class="pane">
          <div class="head"><h2>Demos</h2><span class="sub">a copy is written to your folder</span></div>
          {known.value.demos.map((demo) => <button class="project-row" data-demo={demo.name} onClick={() => openProject("demo", { name: demo.name })}><Icon name="run" /><b>{demo.name}</b><span class="q">{demo.title}</span></button>)}
          <div class="head mid"><h2>New project</h2><span class="sub">an empty one, in a folder of its own</span></div>
          <form class="pad open-path" onSubmit={(event) => { event.preventDefault(); void openProject("new", { name: name.value }, "data"); }}>
            <label class="field" style={{ flex: 1 }}><Icon name="plus" kind="q" /><input aria-label="Name of the new project" placeholder="name" value={name.value} onInput={(event) => { name.value = event.currentTarget.value; }} /></label>
            <button class="btn" type="submit" disabled={!name.value.trim()}>Create</button>
            <button class="btn" type="button" title="A new project named after a Simulink model (.slx, .mdl) or formula text (.kf), which becomes its function. Or drop the file here." onClick={() => pickFile(".slx,.mdl,.kf", newFrom)}>From a model…</button>
          </form>
          <div class="head mid"><h2>Open</h2><span class="sub">a kennfeld.toml, or a folder to start in</span></div>
          <form class="pad open-path" onSubmit={(event) => { event.preventDefault(); void openProject("open", { path: path.value }); }}>
            <label class="field" style={{ flex: 1 }}><Icon name="folder" kind="q" /><input aria-label="Path of a project" placeholder="path of a kennfeld.toml" value={path.value} onInput={(event) => { path.value = event.currentTarget.value; }} /></label>
            <button class="btn primary" type="submit">Open</button>
          </form>
        </section>
        <section class="pane">
          <div class="head"><h2>Recent projects</h2></div>
          {known.value.recent.length === 0 && <p class="pad q">Projects that you open are listed here.</p>}
          {known.value.recent.map((each) => <button class="project-row" onClick={() => openProject("open", { path: each.path })}><Icon name="file" /><b>{each.name}</b><span class="q cut">{each.folder}</span></button>)}
        </section>
      </main>
      <Footer />
    </>
  );
}
