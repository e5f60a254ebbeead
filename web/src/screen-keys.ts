// Keys of a screen that act without Ctrl, Alt or Meta, wherever the cursor is on it.

import { useEffect } from "preact/hooks";

/**
 * Handle the plain keys of a screen while it is shown; those of a dialog belong to it. `act` returns whether it took
 * the key; `typing` is true in a field, which most keys belong to.
 */
export function useScreenKeys(act: (event: KeyboardEvent, typing: boolean) => boolean): void {
  useEffect(() => {
    const handle = (event: KeyboardEvent): void => {
      if (document.querySelector("dialog[open]") !== null || event.ctrlKey || event.metaKey || event.altKey) return;
      const typing = (event.target as HTMLElement).closest("input, select, textarea") !== null;
      if (act(event, typing)) event.preventDefault();
    };
    addEventListener("keydown", handle);
    return () => removeEventListener("keydown", handle);
  }, []);
}
