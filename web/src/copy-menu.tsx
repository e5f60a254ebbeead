// A small button at the picture or table under the mouse, and its menu: copy, save. The palette has the same by name.

import { signal } from "@preact/signals";
import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { type Copied, copiedAt, take, WAYS } from "./copying";
import { Icon } from "./icons";

interface Shown {
  own: Copied;
  left: number;
  top: number;
  open: boolean;
}
const shown = signal<Shown | null>(null);

const same = (own: Copied): boolean => shown.value?.own.element === own.element;

function follow(event: PointerEvent): void {
  const target = event.target as Element;
  if (shown.value?.open || target.closest?.(".copy-menu") || event.buttons !== 0) return;
  const own = target.closest?.("main") ? copiedAt(target) : null;
  if (own === null) shown.value = null;
  else if (!same(own)) {
    const at = own.element.getBoundingClientRect();
    const pane = own.element.closest(".pane")?.getBoundingClientRect() ?? at;
    const [right, top] = [Math.min(at.right, pane.right), Math.max(at.top, pane.top)];
    // small ones, such as sparklines, would be hidden by the button
    shown.value = at.width < 90 || at.height < 40 ? null : { own, left: right - 22, top: top + 2, open: false };
  }
}

function menu(event: MouseEvent): void {
  const own = copiedAt(event.target as Element);
  if (own?.kind !== "picture") return; // the browser's own menu pastes into tables
  event.preventDefault();
  shown.value = { own, left: event.clientX, top: event.clientY, open: true };
}

const close = (): void => {
  shown.value = null;
};

export function CopyMenu() {
  const box = useRef<HTMLDivElement>(null);
  const own = shown.value;
  useEffect(() => {
    addEventListener("pointerover", follow);
    addEventListener("contextmenu", menu);
    addEventListener("scroll", close, true);
    return () => {
      removeEventListener("pointerover", follow);
      removeEventListener("contextmenu", menu);
      removeEventListener("scroll", close, true);
    };
  }, []);
  useLayoutEffect(() => {
    if (!own?.open) return;
    box.current?.querySelector<HTMLElement>("[role=menuitem]")?.focus();
    const outside = (event: Event): void => {
      if (!box.current?.contains(event.target as Node)) close();
    };
    addEventListener("pointerdown", outside);
    return () => removeEventListener("pointerdown", outside);
  }, [own?.open]);
  if (own === null) return null;
  const keys = (event: KeyboardEvent): void => {
    const items = [...box.current!.querySelectorAll<HTMLElement>("[role=menuitem]")];
    const at = items.indexOf(document.activeElement as HTMLElement);
    if (event.key === "Escape") close();
    else if (event.key === "ArrowDown") items[(at + 1) % items.length]?.focus();
    else if (event.key === "ArrowUp") items.at(at - 1)?.focus();
    else return;
    event.preventDefault();
    event.stopPropagation();
  };
  const left = Math.min(own.left, innerWidth - (own.open ? 150 : 24));
  return (
    <div class="copy-menu" ref={box} style={{ left: `${left}px`, top: `${own.top}px` }}>
      {own.open ? (
        <div class="over" role="menu" aria-label={`Copy or save ${own.own.label}`} onKeyDown={keys}>
          {WAYS[own.own.kind].map(([way, text]) => (
            <button
              key={way}
              role="menuitem"
              data-way={way}
              onClick={() => {
                close();
                void take(own.own, way);
              }}
            >
              {text}
            </button>
          ))}
        </div>
      ) : (
        <button
          class="btn bare small"
          tabIndex={-1}
          title={`Copy or save ${own.own.label || `the ${own.own.kind}`}`}
          aria-label={`Copy or save ${own.own.label || `the ${own.own.kind}`}`}
          onClick={() => {
            shown.value = { ...own, left: own.left - 126, open: true };
          }}
        >
          <Icon name="copy" />
        </button>
      )}
    </div>
  );
}
