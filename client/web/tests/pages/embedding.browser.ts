import { resolve } from "node:path";
import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { startChromium } from "../support/chromium.js";
import { JobServer } from "./server.js";
import { Site } from "./site.js";
import { choose, coloursOf, folderOf, keepPicture, live, shown } from "./support.js";

const archive = resolve(import.meta.dirname, "../../../../tests/golden/bundles/ball.relight.zip");

type Share = { readonly id: string; readonly url: string; readonly frame_ancestors: string[] };

const server = new JobServer(true);
const shop = new Site();
const stranger = new Site();
let browser: Browser;
let frameHtml = "";
let elementHtml = "";
let share: Share;

beforeAll(async () => {
  [browser] = await Promise.all([startChromium(), server.start(), shop.start(), stranger.start()]);
  const context = await browser.newContext({ viewport: { width: 1100, height: 900 } });
  await context.grantPermissions(["clipboard-read", "clipboard-write"]);
  const page = await context.newPage();
  await page.goto(server.link);
  await live(page);
  await choose(page, folderOf("bowl", { "transforms_train.json": "{}", "train/1.png": "one" }));
  await page.waitForURL(/#\/scenes\//);
  await page.check("input[value=tiny]");
  await page.click("text=More settings");
  await page.fill("#settings", `num_steps=1\nbundle=${archive}`);
  await page.click("text=Start the job");
  await page.waitForURL(/#\/jobs\//);
  // Someone types the address of a page; what counts is its origin.
  await page.click("summary:text-is('Share a link')");
  await page.fill("#sites", `${shop.origin}/bowls.html`);
  await page.click("text=Create a link");
  const copiedBy = async (text: string): Promise<string> => {
    await page.click(`text=${text}`);
    await page.waitForSelector("text=was copied");
    return page.evaluate(() => navigator.clipboard.readText());
  };
  await page.waitForSelector(`text=may be shown on ${shop.origin}`);
  frameHtml = await copiedBy("Copy as iframe");
  elementHtml = await copiedBy("Copy as element");
  const job = page.url().split("/").at(-1)!;
  const { bundle_id: bundle } = await server.ask<{ bundle_id: string }>("GET", `/v1/jobs/${job}`);
  const { items } = await server.ask<{ items: Share[] }>("GET", `/v1/bundles/${bundle}/shares`);
  share = items[0]!;
  await context.close();
  for (const site of [shop, stranger]) {
    site.pages.set("/frame", frameHtml);
    site.pages.set("/element", elementHtml);
  }
}, 300_000);
afterAll(async () => {
  await browser?.close();
  shop.close();
  stranger.close();
  await server.close();
});

/** Open a page in a browser that has never been anywhere, and remember what it complains of. */
async function visit(address: string): Promise<{ page: Page; complaints: string[] }> {
  const context = await browser.newContext({ viewport: { width: 700, height: 520 } });
  const page = await context.newPage();
  const complaints: string[] = [];
  page.on("console", (message) => {
    if (message.type() === "error") complaints.push(message.text());
  });
  page.on("pageerror", (error) => complaints.push(error.message));
  await page.goto(address);
  return { page, complaints };
}

describe("a shared bundle on another site", () => {
  it("is seen in a frame, without cookies", async () => {
    const { page, complaints } = await visit(`${shop.origin}/frame`);
    const frame = page.frames()[1]!;
    await shown(frame);
    expect(frame.url().startsWith(`${server.url}/embed/${share.id}#`)).toBe(true);
    await keepPicture(page, "framed");
    expect(await coloursOf(page, "iframe")).toBeGreaterThan(20);
    expect(await page.context().cookies()).toEqual([]);
    expect(
      await frame.evaluate(() => document.querySelector("lambent-viewer")!.hasAttribute("controls")),
    ).toBe(false);
    expect(complaints).toEqual([]);
  });

  it("is seen in the element, whose scripts and files come from our server", async () => {
    const { page, complaints } = await visit(`${shop.origin}/element`);
    await shown(page);
    await keepPicture(page, "element-elsewhere");
    expect(await coloursOf(page, "lambent-viewer")).toBeGreaterThan(20);
    const title = await page.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.bundle!.name);
    expect(title).not.toBe("");
    expect(complaints).toEqual([]);
  });

  it("is seen in pages that isolate themselves", async () => {
    shop.headers = {
      "cross-origin-embedder-policy": "require-corp",
      "cross-origin-opener-policy": "same-origin",
    };
    for (const kind of ["frame", "element"]) {
      const { page } = await visit(`${shop.origin}/${kind}`);
      expect(await page.evaluate(() => crossOriginIsolated)).toBe(true);
      await shown(kind === "frame" ? page.frames()[1]! : page);
      expect(await coloursOf(page, kind === "frame" ? "iframe" : "lambent-viewer")).toBeGreaterThan(20);
    }
    shop.headers = {};
  });

  it("is seen in the element under the policy that the documentation names", async () => {
    const at = server.url;
    shop.headers = {
      "content-security-policy":
        `default-src 'none'; script-src ${at}; connect-src ${at}; worker-src blob: ${at}; img-src ${at} blob:; ` +
        "style-src 'unsafe-inline'",
    };
    const { page, complaints } = await visit(`${shop.origin}/element`);
    shop.headers = {};
    expect(complaints).toEqual([]);
    await shown(page);
    expect(complaints).toEqual([]);
  });

  it("is refused to a site that the link does not name", async () => {
    const framed = await visit(`${stranger.origin}/frame`);
    await expect.poll(() => framed.complaints.join("\n"), { timeout: 10_000 }).toContain("frame-ancestors");
    expect(framed.page.frames()[1]!.url()).not.toContain(server.url);
    expect(await coloursOf(framed.page, "iframe")).toBeLessThan(20);
    const { page } = await visit("about:blank");
    await page.goto(`${stranger.origin}/element`, { waitUntil: "commit" });
    await page.locator("lambent-viewer [data-problem]").waitFor();
    expect(await page.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.bundle)).toBeNull();
  });

  it("by itself is a page with controls, with a name and a picture for previews", async () => {
    const { page } = await visit(share.url);
    await shown(page);
    expect(await page.title()).toBe("bowl");
    expect(await page.locator(".panel").isVisible()).toBe(true);
    expect(await page.locator("summary:text-is('Share')").isVisible()).toBe(false);
    const image = (await page.getAttribute("meta[property='og:image']", "content"))!;
    expect(new URL(image).origin).toBe(server.url);
    const answer = await fetch(image);
    expect([answer.status, answer.headers.get("content-type")]).toEqual([200, "image/png"]);
    await page.reload();
    await shown(page);
  });

  it("is seen nowhere after the link was taken back", async () => {
    const { page } = await visit(`${shop.origin}/frame`);
    await shown(page.frames()[1]!);
    await server.ask("DELETE", `/v1/shares/${share.id}`).catch(() => {});
    await page.reload();
    await page.frames()[1]!.waitForSelector("text=revoked");
    const element = await visit(`${shop.origin}/element`);
    await element.page.locator("lambent-viewer [data-problem]").waitFor();
  });
});
