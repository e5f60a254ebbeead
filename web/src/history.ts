// The address of the page follows what it shows, and Back and Forward show it again.

import { effect } from "@preact/signals";
import { formatRoute, isSamePlace, parseRoute, type Route } from "./route";
import { projectId } from "./scope";
import { failure, open, openName, request, screen, state } from "./store";

const present = (): Route => ({
  project: state.value.project?.id ?? "",
  screen: screen.value,
  name: screen.value === "parameters" ? openName.value : "",
});

/** Show what the address names, with the first state, and follow from then on. */
export function begin(): void {
  const asked = parseRoute(location.hash);
  if (state.value.project === null) {
    screen.value = "start";
    if (asked.project) failure.value = `${asked.project} is not among the projects that were opened here.`;
  } else if (asked.project === state.value.project.id) show(asked);
  effect(() => {
    const next = present();
    const address = formatRoute(next);
    if (address === location.hash) return;
    const before = parseRoute(location.hash);
    if (before.project === "" || isSamePlace(before, next)) history.replaceState(null, "", address);
    else history.pushState(null, "", address);
  });
  addEventListener("popstate", () => void goTo(parseRoute(location.hash)));
}

function show({ screen: asked, name }: Route): void {
  if (asked !== null) screen.value = asked;
  if (name !== "" && name !== openName.value && state.value.parameters.some((each) => each.name === name)) open(name);
}

async function goTo(route: Route): Promise<void> {
  if (route.project === "" || route.project === projectId()) show(route);
  else if ((await request("show", { project: route.project })) !== null) show(route);
}
