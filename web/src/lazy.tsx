// Screens that are loaded when they are first shown, or when the page has nothing else to do.

import { signal } from "@preact/signals";
import type { JSX } from "preact";

type Component = () => JSX.Element;

/** Return a component that stands for one of a module of its own, and a function that loads it. */
export function lazy(load: () => Promise<Component>): { Shown: Component; load: () => void } {
  const component = signal<Component | null>(null);
  const failed = signal(false);
  let begun = false;
  const start = () => {
    if (begun) return;
    begun = true;
    load().then(
      (loaded) => {
        component.value = loaded;
      },
      () => {
        failed.value = true;
      },
    );
  };
  const Shown = () => {
    const Loaded = component.value;
    if (Loaded !== null) return <Loaded />;
    start();
    if (!failed.value)
      return (
        <main>
          <p class="pad q">Loading</p>
        </main>
      );
    return (
      <main>
        <p class="pad">
          This screen could not be loaded, because the connection was lost.{" "}
          <button class="btn small" onClick={() => location.reload()}>
            Load the page again
          </button>
        </p>
      </main>
    );
  };
  return { Shown, load: start };
}
