import { createHash } from "node:crypto";
import { readdirSync, readFileSync, statSync } from "node:fs";
import { join, relative, sep } from "node:path";
import preact from "@preact/preset-vite";
import { build, defineConfig, type InlineConfig, type Plugin } from "vite";

const BUILD = ["package-lock.json", "tsconfig.json", "vite.config.ts"];
const APP = ["src", "public", "index.html", ...BUILD];
const REPORT = ["src/drawing", "src/report", "src/tokens.css", ...BUILD];

function filesIn(path: string): string[] {
  return statSync(path).isDirectory() ? readdirSync(path).flatMap((name) => filesIn(join(path, name))) : [path];
}

/** Write a digest of the sources beside a bundle, so that a test can tell whether they belong together. */
function digest(sources: string[]): Plugin {
  return {
    name: "digest",
    generateBundle() {
      const hash = createHash("sha256");
      const files = sources
        .flatMap(filesIn)
        .map((path) => relative(".", path).split(sep).join("/"))
        .sort();
      for (const name of files) hash.update(`${name}\n`).update(readFileSync(name)).update("\n");
      this.emitFile({ type: "asset", fileName: "sources.sha256", source: `${hash.digest("hex")}\n` });
    },
  };
}

// One script and one stylesheet, which the Python side writes into the HTML file of a report.
const report: InlineConfig = {
  configFile: false,
  logLevel: "warn",
  publicDir: false,
  plugins: [digest(REPORT)],
  build: {
    outDir: "../src/kennfeld/report/static",
    emptyOutDir: true,
    cssCodeSplit: false,
    rollupOptions: {
      input: "src/report/main.ts",
      output: { format: "iife", entryFileNames: "report.js", assetFileNames: "report[extname]" },
    },
  },
};

const buildReport = (): Plugin => ({
  name: "report",
  apply: "build",
  closeBundle: async () => {
    await build(report);
  },
});

// The bundles are committed: names without hashes, and no source maps.
export default defineConfig({
  base: "/static/",
  plugins: [preact(), digest(APP), buildReport()],
  build: {
    outDir: "../src/kennfeld/app/static",
    emptyOutDir: true,
    modulePreload: { polyfill: false }, // a polyfill would be a script within the page
    assetsInlineLimit: 0,
    rollupOptions: {
      output: { entryFileNames: "app.js", chunkFileNames: "[name].js", assetFileNames: "[name][extname]" },
    },
  },
});
