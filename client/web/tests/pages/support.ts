/** Helpers for tests of the job pages. */

import { mkdirSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import type { Page } from "playwright-core";

const axeSource = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const pictures = resolve(import.meta.dirname, "../../build/browser-tests");

/** Write files to a new folder of this name and return its path. */
export function folderOf(name: string, contents: Readonly<Record<string, string>>): string {
  const folder = join(mkdtempSync(join(tmpdir(), "lambent-capture-")), name);
  for (const [path, text] of Object.entries(contents)) {
    mkdirSync(dirname(join(folder, path)), { recursive: true });
    writeFileSync(join(folder, path), text);
  }
  return folder;
}

/** Choose a folder in the page's panel. */
export async function choose(page: Page, folder: string): Promise<void> {
  await page.setInputFiles("input[type=file][webkitdirectory]", folder);
}

/** Wait until the page follows the server. */
export async function live(page: Page): Promise<void> {
  await page.waitForFunction(() => document.querySelector("#connection")?.textContent === "live");
}

/** Return what axe-core finds serious or worse, with the elements it is about. */
export async function serious(page: Page): Promise<string[]> {
  // Through the debugger, because the pages' policy lets no script in.
  await page.evaluate(axeSource);
  return page.evaluate(async () => {
    const { axe } = globalThis as unknown as {
      axe: {
        run: () => Promise<{ violations: { id: string; impact: string; nodes: { html: string }[] }[] }>;
      };
    };
    const { violations } = await axe.run();
    return violations
      .filter((each) => each.impact === "serious" || each.impact === "critical")
      .map((each) => `${each.id}: ${each.nodes.map((node) => node.html).join(" ")}`);
  });
}

/** Return by how many pixels the page is wider than a phone. */
export async function overflowOnPhone(page: Page): Promise<number> {
  const before = page.viewportSize()!;
  await page.setViewportSize({ width: 360, height: 740 });
  const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  await page.setViewportSize(before);
  return over;
}

/** Keep a picture of the whole page for people to look at. */
export async function keepPicture(page: Page, name: string): Promise<void> {
  mkdirSync(pictures, { recursive: true });
  await page.screenshot({ path: join(pictures, `${name}.png`), fullPage: true });
}
