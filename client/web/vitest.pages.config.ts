import { defineConfig } from "vitest/config";

// The pages of jobs in a real browser, against a real server; `tests/e2e/test_web_jobs.py` runs them with `make test`.
export default defineConfig({
  test: {
    include: ["tests/pages/**/*.browser.ts"],
    globalSetup: ["tests/support/checkout.ts"],
    testTimeout: 120_000,
    hookTimeout: 120_000,
    fileParallelism: false,
  },
});
