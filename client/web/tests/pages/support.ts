/** Helpers for tests of the job pages. */

import { mkdirSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import type { Frame, Page } from "playwright-core";
import { expect } from "vitest";

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

/** Expect that a page is usable by all, and fits a phone. */
export async function usable(page: Page): Promise<void> {
  expect(await serious(page)).toEqual([]);
  const before = page.viewportSize()!;
  await page.setViewportSize({ width: 360, height: 740 });
  const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  await page.setViewportSize(before);
  expect(over).toBeLessThanOrEqual(0);
}

/** Keep a picture of the whole page for people to look at. */
export async function keepPicture(page: Page, name: string): Promise<void> {
  mkdirSync(pictures, { recursive: true });
  // What stays in the window while the page is scrolled would cover something else.
  const scrolled = await page.evaluate(() => scrollY);
  await page.evaluate(() => scrollTo(0, 0));
  await page.screenshot({ path: join(pictures, `${name}.png`), fullPage: true });
  await page.evaluate((y) => scrollTo(0, y), scrolled);
}

/** Wait until the viewer of a page or a frame shows its bundle. */
export async function shown(frame: Page | Frame): Promise<void> {
  const isShown = () => document.querySelector("lambent-viewer")?.viewer?.bundle != null;
  // Several viewers share the processor in tests of pages that stay open.
  await frame.waitForFunction(isShown, undefined, { timeout: 60_000 });
  await frame.evaluate(async () => {
    const element = document.querySelector("lambent-viewer")!;
    await element.ready;
    element.viewer!.drawNow(2);
  });
}

/** Return how many colours (of 16 levels a channel) a part of a page shows. */
export async function coloursOf(page: Page, selector: string): Promise<number> {
  const picture = (await page.locator(selector).screenshot()).toString("base64");
  const reader = await page.context().browser()!.newPage();
  const count = await reader.evaluate(async (text) => {
    const image = new Image();
    image.src = `data:image/png;base64,${text}`;
    await image.decode();
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d")!;
    context.drawImage(image, 0, 0);
    const { data } = context.getImageData(0, 0, image.width, image.height);
    const seen = new Set<number>();
    for (let at = 0; at < data.length; at += 4) {
      seen.add(((data[at]! >> 4) << 8) | ((data[at + 1]! >> 4) << 4) | (data[at + 2]! >> 4));
    }
    return seen.size;
  }, picture);
  await reader.close();
  return count;
}
