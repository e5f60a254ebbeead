// A panel that folds, and remembers whether it is open.

import { signal } from "@preact/signals";
import type { ComponentChildren } from "preact";

const opened = signal<Record<string, boolean>>({});

/** True if a panel has been opened. */
export const isOpen = (name: string): boolean => opened.value[name] ?? false;

export function Fold({
  title,
  sub = "",
  name,
  open = false,
  forced = false,
  close,
  children,
}: {
  title: string;
  sub?: string;
  name: string;
  open?: boolean;
  forced?: boolean;
  close?: () => void;
  children: ComponentChildren;
}) {
  const shown = forced || (opened.value[name] ?? open);
  return (
    <section class="fold" data-fold={name}>
      <button
        class="head mid"
        aria-expanded={shown}
        onClick={() => {
          opened.value = { ...opened.value, [name]: !shown };
          if (shown) close?.();
        }}
      >
        <i>{shown ? "⌄" : "›"}</i>
        <h2>{title}</h2>
        <span class="sub">{sub}</span>
      </button>
      {shown && children}
    </section>
  );
}
