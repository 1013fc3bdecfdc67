/** The pages of jobs, with a server that always answers the same. */

import type { BrowserContext, Page } from "playwright-core";
import { describe, expect, inject, it } from "vitest";
import { answerAs } from "../support/cannedServer.js";
import { sharedChromium } from "../support/chromium.js";
import { overflowing } from "../support/englishTexts.js";

const phone = { width: 390, height: 844 };
const desk = { width: 1280, height: 800 };

const browser = await sharedChromium();

async function opened(context: BrowserContext, address: string): Promise<Page> {
  const page = await context.newPage();
  page.setDefaultTimeout(120_000);
  page.on("pageerror", (error) => {
    throw error;
  });
  await answerAs(page, "full");
  await page.goto(`${inject("site")}/${address}`);
  return page;
}

it("names of figures break between their words on a phone", async () => {
  const context = await browser.newContext({ viewport: phone });
  const page = await opened(context, "jobs.html#/jobs/job_3");
  await page.waitForSelector("#figures dd");
  await page.click("summary:text-is('All figures')");
  const lines = await page.evaluate(() =>
    [...document.querySelectorAll('#figures th[scope="row"]')].map((name) => {
      const found: string[] = [];
      let bottom = 0;
      const walker = document.createTreeWalker(name, NodeFilter.SHOW_TEXT);
      for (let node = walker.nextNode(); node !== null; node = walker.nextNode()) {
        for (const [place, sign] of [...node.textContent!].entries()) {
          const range = document.createRange();
          range.setStart(node, place);
          range.setEnd(node, place + 1);
          const { top, height } = range.getBoundingClientRect();
          if (top > bottom - height / 2) found.push("");
          bottom = top + height;
          found[found.length - 1] += sign;
        }
      }
      return found;
    }),
  );
  expect(lines).toContainEqual(["albedo_rgb_ratio/", "psnr_gamma"]);
  expect(lines.flatMap((each) => each.slice(0, -1)).filter((line) => !/[/_]$/.test(line))).toEqual([]);
  expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBe(0);
  await context.close();
});

describe.each(["en-US", "de-DE"])("in a browser that speaks %s", (locale) => {
  it.each([phone, desk])(
    "all of the share panel fits a window of $width x $height pixels",
    async (viewport) => {
      const context = await browser.newContext({ locale, viewport });
      const viewer = await opened(context, `viewer.html#src=${inject("site")}/v1/bundles/bundle_1`);
      await viewer.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer != null);
      await viewer.evaluate(async () => {
        const element = document.querySelector("lambent-viewer")!;
        await element.ready;
        for (const part of element.shadowRoot!.querySelectorAll("details")) part.open = true;
      });
      await viewer.waitForSelector(".shares li");
      expect(await overflowing(viewer, "#share")).toEqual([]);
      const page = await opened(context, "jobs.html#/jobs/job_3");
      await page.waitForSelector("#figures dd");
      await page.evaluate(() => {
        for (const part of document.querySelectorAll("details")) part.open = true;
      });
      await page.waitForSelector(".shares li");
      expect(await overflowing(page, "#results")).toEqual([]);
      await context.close();
    },
  );
});

it("the editor of masks lets go of every picture that it does not show", async () => {
  const context = await browser.newContext({ viewport: desk });
  await context.addInitScript(() => {
    const open = new Set<ImageBitmap>();
    const make = globalThis.createImageBitmap.bind(globalThis);
    globalThis.createImageBitmap = async (...given: [ImageBitmapSource]) => {
      const bitmap = await make(...given);
      open.add(bitmap);
      return bitmap;
    };
    const { close } = ImageBitmap.prototype;
    ImageBitmap.prototype.close = function () {
      open.delete(this);
      close.call(this);
    };
    Object.assign(globalThis, { openBitmaps: open });
  });
  const page = await opened(context, "jobs.html#/scenes/scene_5/masks");
  const held = (count: number) =>
    page.waitForFunction(
      (wanted) => (globalThis as unknown as { openBitmaps: Set<ImageBitmap> }).openBitmaps.size === wanted,
      count,
    );
  await page.waitForSelector(".masks[data-drawn]");
  // The small photographs, which are drawn again with every new mask.
  await held(12);
  await page.click(".shots button >> nth=2");
  await held(13);
  // Faster than pictures come.
  for (let times = 0; times < 4; times++) await page.keyboard.press("PageDown");
  await held(13);
  await page.keyboard.press("Escape");
  await held(12);
  await page.click(".shots button >> nth=2");
  await held(13);
  await page.click("text=The scene");
  await page.waitForSelector(".presets label");
  await held(0);
  await context.close();
});
