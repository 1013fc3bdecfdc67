import type { BrowserContext, Page } from "playwright-core";
import { beforeAll, expect, inject, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { fixedView } from "./support.js";

type Link = { id: string; bundle_id: string; url: string; expires_at: string };

const browser = await sharedChromium();
let context: BrowserContext;
let page: Page;
let loggedIn = true;
const links: Link[] = [];
const asked: { expires_in_s: number }[] = [];

/** The part of the REST interface that is about links; a real server is behind tests/pages. */
async function answerLinks(page: Page): Promise<void> {
  await page.route("**/v1/bundles/bundle_1/shares", async (route) => {
    if (!loggedIn) return route.fulfill({ status: 401, json: { code: "unauthenticated", detail: "log in" } });
    if (route.request().method() === "GET") return route.fulfill({ json: { items: links } });
    expect(route.request().headers()["x-lambent-csrf"]).toBe("1");
    asked.push(route.request().postDataJSON());
    const id = `share_${links.length + 1}`;
    const url = `${inject("site")}/embed/${id}#${id}.secret`;
    links.push({ id, bundle_id: "bundle_1", url, expires_at: "2030-01-02T00:00:00Z" });
    return route.fulfill({ status: 201, json: links.at(-1) });
  });
  await page.route("**/v1/shares/*", (route) => {
    const id = route.request().url().split("/").at(-1);
    links.splice(
      links.findIndex((link) => link.id === id),
      1,
    );
    return route.fulfill({ status: 204 });
  });
}

beforeAll(async () => {
  context = await browser.newContext({ viewport: { width: 900, height: 700 } });
  await context.grantPermissions(["clipboard-read", "clipboard-write"]);
  page = await context.newPage();
  await answerLinks(page);
});

/** Open the viewer's page on a bundle. */
async function open(src: string): Promise<void> {
  const view = new URLSearchParams({ ...fixedView, rotate: "40,0,0" });
  await page.goto("about:blank");
  await page.goto(`${inject("site")}/viewer.html#src=${src}&${view}`);
  await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer?.bundle != null);
}

it("a bundle of the server is shared by a link with the view, which ends and is taken back", async () => {
  await open("/v1/bundles/bundle_1");
  await page.click("summary:text-is('Share')");
  await page.selectOption("#lifetime", { label: "30 days" });
  await page.click("text=Create a link");
  await page.waitForSelector("text=The link was created and copied.");
  expect(asked).toEqual([{ expires_in_s: 30 * 24 * 3600 }]);
  const copied = await page.evaluate(() => navigator.clipboard.readText());
  const parameters = await page.evaluate(() => document.querySelector("lambent-viewer")!.parameters);
  expect(copied).toBe(`${links[0]!.url}&${parameters}`);
  expect(parameters).toContain("rotate=40");
  await page.click("text=Revoke");
  await page.waitForSelector("text=no longer works");
  expect(links).toEqual([]);
});

it("a visitor who is not logged in sees why there are no links", async () => {
  loggedIn = false;
  await open("/v1/bundles/bundle_1");
  await page.click("summary:text-is('Share')");
  await page.waitForSelector("text=This browser is not logged in");
});

it("a bundle of another kind of host offers no links", async () => {
  await open("data/bundle/");
  expect(await page.locator("summary:text-is('Share')").isVisible()).toBe(false);
});

it("a link to a view in a dropped map says so, and carries the map once it is uploaded", async () => {
  const map = Buffer.from(
    "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n\x80\x80\x80\x81\x80\x80\x80\x81",
    "latin1",
  );
  const uploaded: { name: string | null; body: Buffer }[] = [];
  await page.route("**/v1/environments?*", (route) => {
    expect(route.request().headers()["x-lambent-csrf"]).toBe("1");
    const name = new URL(route.request().url()).searchParams.get("name");
    uploaded.push({ name, body: route.request().postDataBuffer()! });
    return route.fulfill({ status: 201, json: { id: "env_1", name, url: "/v1/blobs/abc" } });
  });
  await page.route("**/v1/blobs/abc", (route) => route.fulfill({ body: map }));
  await open("/v1/bundles/bundle_1");
  await page.evaluate(async (text) => {
    const data = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    await document.querySelector("lambent-viewer")!.setEnvironmentFile(new File([data], "my light.hdr"));
  }, map.toString("base64"));
  await page.click("summary:text-is('Save')");
  await page.click("text=Copy link to this view");
  await page.waitForSelector("text=It does not include my light.hdr, which is on this computer only.");
  await page.click("text=Copy without");
  await page.waitForSelector("text=The link was copied. It does not include my light.hdr");
  expect(await page.evaluate(() => navigator.clipboard.readText())).not.toContain("env=");
  await page.click("text=Copy link to this view");
  await page.click("text=Upload and copy");
  await expect.poll(() => page.evaluate(() => navigator.clipboard.readText())).toContain("env=");
  expect(uploaded).toEqual([{ name: "my light.hdr", body: map }]);
  const link = new URL(await page.evaluate(() => navigator.clipboard.readText()));
  const parameters = new URLSearchParams(link.hash.slice(1));
  expect(parameters.get("env")).toBe("url:/v1/blobs/abc#my%20light.hdr");
  expect(parameters.get("src")).toBe("/v1/bundles/bundle_1");
  const pressed = page.locator(".chip[aria-pressed=true]");
  await expect.poll(() => pressed.textContent()).toBe("my light.hdr");
  // Whoever opens the link sees it.
  await page.goto("about:blank");
  await page.goto(link.href);
  await expect.poll(() => pressed.textContent()).toBe("my light.hdr");
});

it("a link from a bundle of another kind of host says what it cannot carry, and offers no upload", async () => {
  await open("data/bundle/");
  await page.evaluate(async () => {
    const text = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n\x80\x80\x80\x81\x80\x80\x80\x81";
    const data = Uint8Array.from(text, (c) => c.charCodeAt(0));
    await document.querySelector("lambent-viewer")!.setEnvironmentFile(new File([data], "a.hdr"));
  });
  await page.click("summary:text-is('Save')");
  await page.click("text=Copy link to this view");
  await page.waitForSelector("text=The link was copied. It does not include a.hdr, which is on this");
});
