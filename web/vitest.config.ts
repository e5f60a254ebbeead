import { defineConfig } from "vitest/config";

// Tests of what needs no page; the page itself is tested in a browser, by tests/app of the Python package.
export default defineConfig({ test: { include: ["tests/**/*.test.ts"], setupFiles: ["tests/page-stub.ts"] } });
