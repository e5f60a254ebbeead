// A dialog over the page. While it is open, keys reach nothing behind it, Tab stays within it, and Esc closes it.

import type { ComponentChildren } from "preact";
import { useLayoutEffect, useRef } from "preact/hooks";

interface Props {
  label: string;
  kind: string;
  close: () => void;
  children: ComponentChildren;
}

const FOCUSABLE = "button:not([disabled]), input, select, textarea, a[href], [tabindex='0']";

/** Let Tab go from the last element to the first, and back, instead of to the browser around the page. */
function turn(event: KeyboardEvent, own: HTMLElement): void {
  const all = [...own.querySelectorAll<HTMLElement>(FOCUSABLE)];
  const [from, to] = event.shiftKey ? [all[0], all.at(-1)] : [all.at(-1), all[0]];
  if (document.activeElement !== from && own.contains(document.activeElement)) return;
  to?.focus();
  event.preventDefault();
}

export function Dialog({ label, kind, close, children }: Props) {
  const box = useRef<HTMLDialogElement>(null);
  // before the next key comes: the first letters of what is typed belong into the dialog
  useLayoutEffect(() => {
    const before = document.activeElement as HTMLElement | null;
    const own = box.current!;
    own.showModal(); // the browser makes the page behind it inert
    own.querySelector<HTMLElement>("[data-first]")?.focus();
    return () => {
      own.close();
      before?.focus?.({ preventScroll: true });
    };
  }, []);
  return (
    <dialog
      ref={box}
      class={`over ${kind}`}
      aria-label={label}
      onCancel={(event) => {
        event.preventDefault();
        close();
      }}
      onKeyDown={(event) => {
        event.stopPropagation(); // shortcuts belong to the page behind it
        if (event.key === "Tab") turn(event, box.current!);
        if (event.key !== "Escape" && !((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "k")) return;
        event.preventDefault();
        close();
      }}
      onClick={(event) => {
        if (event.target === box.current) close(); // on the ground around it
      }}
    >
      {children}
    </dialog>
  );
}
