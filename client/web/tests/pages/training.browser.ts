import { resolve } from "node:path";
import type { Browser } from "playwright-core";
import { afterAll, beforeAll, expect, it } from "vitest";
import { startChromium } from "../support/chromium.js";
import { JobServer } from "./server.js";
import { choose, keepPicture, live, serious } from "./support.js";

const scene = resolve(import.meta.dirname, "../../../../tests/data/still_life");

let server: JobServer;
let browser: Browser;
beforeAll(async () => {
  server = new JobServer(false);
  [browser] = await Promise.all([startChromium(), server.start()]);
});
afterAll(async () => {
  await browser?.close();
  await server?.close();
});

it("photographs become a bundle that can be looked at", { timeout: 1_200_000 }, async () => {
  const page = await browser.newPage({ viewport: { width: 1100, height: 800 } });
  page.setDefaultTimeout(1_100_000);
  await page.goto(server.link);
  await live(page);
  await choose(page, scene);
  await page.waitForURL(/#\/scenes\//);
  // The order does not wait for the check: a job begins with one of its own.
  await page.check("input[value=tiny]");
  // Less than the preset's own steps: what is learned is tested elsewhere.
  await page.click("text=More settings");
  await page.fill("#settings", "stage_one.num_steps=150\nstage_two.num_steps=30\nstage_two.warmup_steps=10");
  await page.click("text=Start the job");
  await page.waitForURL(/#\/jobs\//);
  await page.waitForSelector("h1 .state:text-is('done')");
  await page.waitForSelector("#figures dd:has-text('dB')");
  await page.waitForSelector(".chart polyline");
  await page.waitForFunction(() => document.querySelector<HTMLImageElement>(".live img")!.naturalWidth > 1);
  // The viewer is in the page, and its picture before it: the object in the light of the studio.
  await page.locator("#results").scrollIntoViewIfNeeded();
  await page.waitForSelector(".viewer lambent-viewer:not(.arriving)");
  const archive = await page.getAttribute("a:has-text('Download .relight.zip')", "href");
  const size = await page.evaluate(async (url) => {
    const answer = await fetch(url!);
    return [Number(answer.headers.get("content-length")), (await answer.blob()).size];
  }, archive);
  expect(size[0]).toBe(size[1]);
  const names = await page.$$eval(".downloads a", (all) => all.map((each) => each.textContent));
  expect(names).toEqual(expect.arrayContaining(["report.json", "report.html", "asset.glb", "manifest.json"]));
  expect(await serious(page)).toEqual([]);
  await keepPicture(page, "trained");
  await page.click("a.button.first");
  await page.waitForURL(/viewer\.html#src=/);
  await page.waitForFunction(() => / · Lambent viewer$/.test(document.title));
});
