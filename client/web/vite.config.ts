import { readdirSync } from "node:fs";
import { resolve } from "node:path";
import { defineConfig } from "vite";
import { pageWords } from "./scripts/pageWords.js";
import { precompress } from "./scripts/precompress.js";
import de from "./src/words/de.json" with { type: "json" };
import en from "./src/words/en.json" with { type: "json" };

const here = import.meta.dirname;
const pages = readdirSync(here).filter((name) => name.endsWith(".html"));

// Pages refer to their files by relative addresses, so that they work from any folder of any host.
export default defineConfig({
  base: "./",
  plugins: [pageWords({ en, de }), precompress()],
  build: {
    outDir: resolve(here, "../python/lambent_pages/dist"),
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    rolldownOptions: {
      // The element for other people's pages has an address that lasts.
      input: [...pages, "src/viewer/embed.ts"].map((name) => resolve(here, name)),
      output: {
        entryFileNames: ({ name }) => (name === "embed" ? "lambent-viewer.js" : "assets/[name]-[hash].js"),
      },
    },
  },
  worker: { format: "es" },
});
