import { resolve } from "node:path";
import type { Browser, BrowserContext, Page } from "playwright-core";
import { afterAll, beforeAll, expect, it } from "vitest";
import { startChromium } from "../support/chromium.js";
import { JobServer } from "./server.js";
import { Site } from "./site.js";
import { coloursOf, keepPicture, live, serious, shown } from "./support.js";

const scene = resolve(import.meta.dirname, "../../../../tests/data/still_life");
const shop = new Site();

let server: JobServer;
let browser: Browser;
let context: BrowserContext;
let page: Page;
/** The HTML that shows the object on another site. */
let frameHtml = "";

beforeAll(async () => {
  server = new JobServer(false);
  [browser] = await Promise.all([startChromium(), server.start(), shop.start()]);
  context = await browser.newContext({ viewport: { width: 1100, height: 800 }, locale: "en-US" });
  await context.grantPermissions(["clipboard-read", "clipboard-write"]);
  page = await context.newPage();
  page.setDefaultTimeout(60_000);
  await page.goto(server.link);
  await live(page);
});
afterAll(async () => {
  await browser?.close();
  shop.close();
  await server?.close();
});

const viewerState = () => page.evaluate(() => document.querySelector("lambent-viewer")!.state);
const chip = (name: string) => page.getByRole("button", { name, exact: true });

/** Drop a folder onto the page, as a hand does: the browser itself reads it. */
async function dropFolder(folder: string): Promise<void> {
  const { x, y, width, height } = (await page.locator(".drop").boundingBox())!;
  const session = await context.newCDPSession(page);
  const place = { x: x + 0.5 * width, y: y + 0.5 * height };
  const data = { items: [], files: [folder], dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"] as const) {
    await session.send("Input.dispatchDragEvent", { type, ...place, data });
  }
  await session.detach();
}

it("photographs that are dropped become a bundle while one watches", { timeout: 1_200_000 }, async () => {
  const long = { timeout: 1_100_000 };
  await dropFolder(scene);
  await page.waitForURL(/#\/scenes\//);
  // The order does not wait for the check: a job begins with one of its own.
  await page.check("input[value=tiny]");
  // Less than the preset's own steps: what is learned is tested elsewhere.
  await page.click("text=More settings");
  await page.fill("#settings", "stage_one.num_steps=150\nstage_two.num_steps=30\nstage_two.warmup_steps=10");
  await page.click("text=Start the job");
  await page.waitForURL(/#\/jobs\//);
  // A picture of what is learned comes before the end.
  await page.waitForFunction(
    () =>
      document.querySelector("h1 .state")?.textContent === "running" &&
      (document.querySelector<HTMLImageElement>(".live img")?.naturalWidth ?? 0) > 1,
    null,
    long,
  );
  await page.waitForSelector("h1 .state:text-is('done')", long);
  await page.waitForSelector("#figures dd:has-text('dB')");
  await page.waitForSelector(".chart polyline", { state: "attached" });
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
});

it("the result is relit in the viewer, by a chip and by the ball", async () => {
  await page.click("a.button.first");
  await page.waitForURL(/viewer\.html#src=/);
  await page.waitForFunction(() => / · Lambent viewer$/.test(document.title));
  await shown(page);
  const before = await coloursOf(page, "lambent-viewer canvas >> nth=0");
  expect(before).toBeGreaterThan(20);
  await chip("Low sun").click();
  await expect.poll(async () => (await viewerState()).environment, { timeout: 30_000 }).toBe("preset:sunset");
  const { yawDeg } = (await viewerState()).turn;
  const { x, y, width, height } = (await page.locator(".ball").boundingBox())!;
  await page.mouse.move(x + 0.5 * width, y + 0.5 * height);
  await page.mouse.down();
  await page.mouse.move(x + 0.5 * width + 24, y + 0.5 * height, { steps: 4 });
  await page.mouse.up();
  // What is in front follows the hand: half a turn is as wide as the ball.
  const turnedBy = (await viewerState()).turn.yawDeg - yawDeg;
  expect(Math.abs(turnedBy)).toBeGreaterThan(30);
  expect(Math.abs(turnedBy)).toBeLessThan(90);
  await keepPicture(page, "relit");
});

it("it is shared with a shop by a link with the light that was chosen", async () => {
  await page.click("summary:text-is('Share')");
  await page.fill("#sites", `${shop.origin}/bowls.html`);
  await page.click("text=Create a link");
  await page.waitForSelector(`text=may be shown on ${shop.origin}`);
  await page.click("text=Copy as iframe");
  await page.waitForSelector("text=was copied");
  frameHtml = await page.evaluate(() => navigator.clipboard.readText());
  expect(frameHtml).toContain(`<iframe src="${server.url}/embed/`);
  expect(frameHtml).toContain("sunset");
});

it("the shop's page shows it to a visitor who is logged in nowhere", async () => {
  shop.pages.set("/bowls.html", frameHtml);
  const visitor = await browser.newContext({ viewport: { width: 700, height: 520 }, locale: "en-US" });
  const there = await visitor.newPage();
  const complaints: string[] = [];
  there.on("pageerror", (error) => complaints.push(error.message));
  await there.goto(`${shop.origin}/bowls.html`);
  const frame = there.frames()[1]!;
  await shown(frame);
  const { environment } = await frame.evaluate(() => document.querySelector("lambent-viewer")!.state);
  expect(environment).toBe("preset:sunset");
  // An empty frame has one colour.
  expect(await coloursOf(there, "iframe")).toBeGreaterThan(20);
  expect(await visitor.cookies()).toEqual([]);
  expect(complaints).toEqual([]);
  await keepPicture(there, "embedded");
  await visitor.close();
});
