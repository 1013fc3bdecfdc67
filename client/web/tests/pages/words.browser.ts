import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import de from "../../src/words/de.json";
import { startChromium } from "../support/chromium.js";
import { englishOn, overflowing, saidOn } from "../support/englishTexts.js";
import { JobServer } from "./server.js";
import { choose, folderOf, keepPicture, serious } from "./support.js";

const capture = { "transforms_train.json": "{}", "train/1.png": "one", "train/2.png": "two" };
const { texts } = de;

let server: JobServer;
let browser: Browser;
let page: Page;

beforeAll(async () => {
  server = new JobServer(true);
  [browser] = await Promise.all([startChromium(), server.start()]);
  page = await browser.newPage({ locale: "de-DE", viewport: { width: 1280, height: 800 } });
});
afterAll(async () => {
  await browser?.close();
  await server?.close();
});

/** Look at what is open on a screen and on a phone. */
async function isGerman(name: string): Promise<void> {
  expect(await englishOn(page)).toEqual([]);
  expect(await serious(page)).toEqual([]);
  for (const [width, height] of [
    [390, 844],
    [1280, 800],
  ] as const) {
    await page.setViewportSize({ width, height });
    expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(
      0,
    );
    expect(await overflowing(page, "main")).toEqual([]);
    await keepPicture(page, `${name}-de-${width}`);
  }
}

describe("in a German browser the pages of jobs", () => {
  it("ask for the login in German", async () => {
    await page.goto(server.url);
    await page.waitForSelector(`h1:text-is("${texts.locked.title}")`);
    expect(await page.title()).toBe("Anmelden · Lambent");
    expect(await page.getAttribute("html", "lang")).toBe("de-DE");
    await isGerman("locked");
  });

  it("begin in German", async () => {
    await page.goto(server.link);
    await page.waitForSelector(`#connection:text-is("${texts.connection.live}")`);
    await page.waitForSelector(`text=${texts.page.noneYet}`);
    expect(await saidOn(page)).toEqual(
      expect.arrayContaining([texts.start.title, texts.upload.chooseFolder, texts.jobs.anyState]),
    );
    await isGerman("start");
  });

  it("tell of a scene, with numbers and times as in German", async () => {
    await choose(page, folderOf("schale", capture));
    await page.waitForURL(/#\/scenes\//);
    await page.waitForSelector(`h1 .state:text-is("${texts.states.ready}")`);
    await page.waitForSelector(".presets :text('etwa 45 Sekunden')");
    await page.waitForSelector("text=3 zum Trainieren, 1 zum Testen");
    const said = (await saidOn(page)).join("\n");
    expect(said).toMatch(/^3 Dateien, \d+ B · erstellt \d\d\.\d\d\.\d{4}, \d\d:\d\d$/m);
    await isGerman("scene");
  });

  it("tell of a job that runs and is cancelled", async () => {
    await page.check("input[value=tiny]");
    await page.click(`text=${texts.order.more}`);
    await page.fill("#settings", "num_steps=120");
    await page.click(`text=${texts.order.start}`);
    await page.waitForURL(/#\/jobs\//);
    await page.waitForSelector(`h1 .state:text-is("${texts.states.running}")`);
    await page.waitForSelector("text=/ \\d+ von 120/");
    await isGerman("job");
    await page.click(`button:text-is("${texts.page.cancel}")`);
    await page.waitForSelector(`h1 .state:text-is("${texts.states.cancelled}")`);
    await isGerman("cancelled");
    await page.click(`text=${texts.job.delete}`);
    await page.waitForSelector(".toast:has-text('Der Job „schale“ wurde gelöscht.')");
    await isGerman("deleted");
  });
});
