// The address of what the page shows, behind the `#`: `ID/parameters/MapX`. It survives a reload, and goes into Back.

import { SCREENS, type Screen } from "./screen-names";

export interface Route {
  project: string; // id; empty if the address names none
  screen: Screen | null;
  name: string; // of the open parameter
}

/** Return what an address names; a screen that does not exist is none. */
export function parseRoute(hash: string): Route {
  const [project = "", screen = "", ...rest] = hash.replace(/^#\/?/, "").split("/").map(decoded);
  return { project, screen: SCREENS.find((each) => each === screen) ?? null, name: rest.join("/") };
}

function decoded(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** Return the address of a screen, and of a parameter on it. */
export function formatRoute({ project, screen, name }: Route): string {
  if (project === "") return "#/";
  const parts = [project, ...(screen === null ? [] : [screen, ...(name === "" ? [] : [name])])];
  return `#/${parts.map(encodeURIComponent).join("/")}`;
}

/** Return if two addresses are one step of the history: only the open parameter differs. */
export const isSamePlace = (a: Route, b: Route): boolean => a.project === b.project && a.screen === b.screen;
