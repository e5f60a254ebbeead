// Icons of 16 x 16, drawn with the colour of the text.

const PATHS: Record<string, string> = {
  undo: "M3 6.5h6.5a3.5 3.5 0 0 1 0 7H6M6 3.5 3 6.5l3 3",
  redo: "M13 6.5H6.5a3.5 3.5 0 0 0 0 7H10m0-10 3 3-3 3",
  find: "M11 7a4 4 0 1 1-8 0 4 4 0 0 1 8 0zm-1 3 3.5 3.5",
  done: "m3 8.5 3.2 3.2L13 4.8",
  warning: "M8 2.2 14.4 13.5H1.6zM8 6.5v3.3M8 11.6v.1",
  plus: "M8 3v10M3 8h10",
  file: "M4 2h5l3 3v9H4zM9 2v3h3",
  link: "M6.5 9.5l3-3M7 5l1.5-1.5a2.5 2.5 0 0 1 3.6 3.6L10.6 8.6M9 11l-1.5 1.5a2.5 2.5 0 0 1-3.6-3.6L5.4 7.4",
  folder: "M2 4h4l1.5 2H14v7H2z",
  copy: "M6 2.5h7.5V10H6zM10 10v3.5H2.5V6H6",
};

export function Icon({ name, kind = "" }: { name: string; kind?: string }) {
  const filled = { run: "M5 3.2v9.6L12.8 8z", stop: "M4 4h8v8H4z" }[name];
  return (
    <svg class={`i ${kind}`} viewBox="0 0 16 16" aria-hidden="true">
      {name === "theme" ? (
        <>
          <circle cx="8" cy="8" r="5.2" />
          <path d="M8 2.8a5.2 5.2 0 0 1 0 10.4z" fill="currentColor" stroke="none" />
        </>
      ) : filled ? (
        <path d={filled} fill="currentColor" stroke="none" />
      ) : (
        <path d={PATHS[name]} />
      )}
    </svg>
  );
}

export function Logo() {
  return (
    <svg width="18" height="18" viewBox="0 0 18 18" aria-hidden="true" fill="var(--accent)">
      {[0, 1, 2].flatMap((i) =>
        [0, 1, 2].map((j) => (
          <rect
            x={1 + 5.5 * i}
            y={12 - 5.5 * j}
            width="4.6"
            height="4.6"
            rx=".6"
            opacity={0.28 + 0.15 * i + 0.16 * j}
          />
        )),
      )}
    </svg>
  );
}
