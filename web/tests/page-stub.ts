// What modules of the page touch when they are loaded: the theme of the document, and the storage of the browser.

const stored = new Map<string, string>();

Object.assign(globalThis, {
  document: { documentElement: { dataset: {} } },
  localStorage: {
    getItem: (key: string) => stored.get(key) ?? null,
    setItem: (key: string, value: string) => void stored.set(key, value),
    clear: () => stored.clear(),
  },
});
