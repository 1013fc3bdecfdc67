/** Keeps a screenshot of every open page when a test fails, in client/web/build/browser-tests; closes the pages of a file. */

import { mkdirSync } from "node:fs";
import { join, resolve } from "node:path";
import { afterAll, afterEach } from "vitest";
import { closePages, sharedChromium } from "../support/chromium.js";

const folder = resolve(import.meta.dirname, "../../build/browser-tests");

afterEach(async ({ task }) => {
  if (task.result?.state !== "fail") return;
  mkdirSync(folder, { recursive: true });
  const browser = await sharedChromium();
  const pages = browser.contexts().flatMap((context) => context.pages());
  for (const [index, page] of pages.entries()) {
    const name = `failed ${task.name} ${index}`.replace(/[^\w]+/g, "_");
    await page.screenshot({ path: join(folder, `${name}.png`), timeout: 20_000 }).catch(() => {});
  }
});

afterAll(async () => closePages(await sharedChromium()));
