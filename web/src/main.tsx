// The page: connects to the server, shows the screen of the present step, and listens to keys.

import { effect } from "@preact/signals";
import { type JSX, render } from "preact";
import { shortcut } from "./commands";
import { connect, listen, whenIdle } from "./connection";
import { takeDrops } from "./dropping";
import { Header, Rail } from "./frame";
import { begin } from "./history";
import { lazy } from "./lazy";
import { Overlays } from "./overlays";
import { Data } from "./screens/data";
import { Optimization } from "./screens/optimization";
import { Parameters } from "./screens/parameters";
import { Results } from "./screens/results";
import { Start } from "./screens/start";
import { connected, message, request, type Screen, screen, state, takeState } from "./store";
import "./style.css";
import "./instruments/settings.css";
import "./screens/data.css";
import "./screens/files.css";
import "./screens/function.css";
import "./screens/optimization.css";
import "./screens/parameters.css";
import "./screens/plots.css";
import "./screens/results.css";
import "./screens/start.css";

const before = state.value;

const LAZY = {
  "control-unit": lazy(async () => (await import("./screens/control-unit")).ControlUnitScreen),
  design: lazy(async () => (await import("./screens/design")).DesignScreen),
  files: lazy(async () => (await import("./screens/files")).Files),
  missing: lazy(async () => (await import("./screens/missing")).MissingScreen),
  function: lazy(async () => (await import("./screens/function")).FunctionScreen),
  plots: lazy(async () => (await import("./screens/plots")).Plots),
};

const SHOWN: Record<Screen, () => JSX.Element> = {
  "control-unit": LAZY["control-unit"].Shown,
  data: Data,
  design: LAZY.design.Shown,
  files: LAZY.files.Shown,
  function: LAZY.function.Shown,
  missing: LAZY.missing.Shown,
  start: Start,
  parameters: Parameters,
  optimization: Optimization,
  results: Results,
  plots: LAZY.plots.Shown,
};

function Page() {
  const Shown = SHOWN[screen.value];
  return (
    <>
      <Header />
      <Rail />
      {/* what components keep by themselves belongs to the project, too */}
      <Shown key={state.value.project?.id ?? ""} />
      <Overlays />
    </>
  );
}

let lost: { path: string; unsaved: boolean } | null = null; // what was open when the connection was lost

/** Take up the project and the unsaved edits again after the server was restarted. */
async function takeUp(): Promise<void> {
  if (lost === null) return;
  const { path, unsaved } = lost;
  lost = null;
  if (path && state.value.project === null && (await request("open", { path })) === null) return;
  if (unsaved && state.value.recoverable && state.value.project?.path === path && (await request("recover")) !== null)
    message.value = "Kennfeld was restarted. Your unsaved edits are back.";
}

listen("state", (reply) => {
  const first = state.value === before;
  takeState(reply);
  void takeUp();
  if (first) begin();
  if (first)
    whenIdle(() => {
      for (const each of Object.values(LAZY)) each.load();
    });
});
connect((on) => {
  if (connected.value && !on && lost === null)
    lost = { path: state.value.project?.path ?? "", unsaved: state.value.unsaved.length > 0 };
  connected.value = on;
});
effect(() => {
  document.title = [state.value.project?.name, "Kennfeld"].filter(Boolean).join(" – ");
});
addEventListener("keydown", shortcut);
takeDrops();
if (matchMedia("(prefers-color-scheme: dark)").matches) document.documentElement.dataset.theme = "dark";
render(<Page />, document.body);
