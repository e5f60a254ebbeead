// Screens that are loaded when they are first shown, or when the page has nothing else to do.

import { signal } from "@preact/signals";
import type { JSX } from "preact";

type Component = () => JSX.Element;

/** Return a component that stands for one of a module of its own, and a function that loads it. */
export function lazy(load: () => Promise<Component>): { Shown: Component; load: () => void } {
  const component = signal<Component | null>(null);
  let begun = false;
  const start = () => {
    if (begun) return;
    begun = true;
    void load().then((loaded) => { component.value = loaded; });
  };
  const Shown = () => {
    const Loaded = component.value;
    if (Loaded !== null) return <Loaded />;
    start();
    return <main class="loading"><p class="pad q">Loading</p></main>;
  };
  return { Shown, load: start };
}
