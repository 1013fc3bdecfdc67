import { defineConfig } from "vitest/config";

// Tests in a real browser, of the built pages; `tests/e2e/test_web_viewer.py` runs them with `make test`.
export default defineConfig({
  test: {
    include: ["tests/browser/**/*.browser.ts"],
    globalSetup: ["tests/browser/setup.ts"],
    testTimeout: 180_000,
    hookTimeout: 300_000,
    fileParallelism: false,
  },
});
