import { defineConfig } from "vitest/config";

// Tests in a real browser, of the built pages; `tests/e2e/test_web_viewer.py` runs them with `make test`.
export default defineConfig({
  test: {
    include: ["tests/browser/**/*.browser.ts"],
    globalSetup: ["tests/browser/setup.ts"],
    setupFiles: ["tests/browser/failures.ts"],
    testTimeout: 180_000,
    hookTimeout: 300_000,
    // One process, so that all files share one browser: it keeps what it compiled.
    fileParallelism: false,
    isolate: false,
  },
});
