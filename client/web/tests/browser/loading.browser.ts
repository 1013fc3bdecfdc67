import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, inject, it } from "vitest";
import { closePages, sharedChromium } from "../support/chromium.js";
import { openViewer } from "./support.js";

let browser: Browser;
let page: Page;

beforeAll(async () => {
  browser = await sharedChromium();
});
afterAll(() => closePages(browser));

async function openWith(answer: (path: string) => Promise<number>): Promise<Page> {
  const opened = await openViewer(browser, {}, null);
  await opened.route("**/data/bundle/**", async (route) => {
    const status = await answer(new URL(route.request().url()).pathname);
    await (status === 200 ? route.continue() : route.fulfill({ status }));
  });
  await opened.evaluate(
    (src) => document.querySelector("lambent-viewer")!.setAttribute("src", src),
    `${inject("site")}/data/bundle/`,
  );
  return opened;
}

const heading = (): Promise<string | null> => page.locator(".welcome h1").textContent();

describe("while a bundle is read", () => {
  it("its name and its bytes are shown, and nothing moves", async () => {
    let release = (): void => {};
    const held = new Promise<void>((resolve) => {
      release = resolve;
    });
    page = await openWith(async (path) => {
      if (path.endsWith(".glb")) await held;
      return 200;
    });
    await page.evaluate(() => {
      Object.assign(globalThis, { shift: 0 });
      new PerformanceObserver((list) => {
        for (const entry of list.getEntries()) {
          (globalThis as unknown as { shift: number }).shift += (entry as unknown as { value: number }).value;
        }
      }).observe({ type: "layout-shift", buffered: true });
    });
    await page.waitForSelector(".welcome h1:text-is('analytic')");
    await page.waitForSelector(".bytes:text-matches('^[0-9.]+ (KiB|MiB) of [0-9.]+ (KiB|MiB)$')");
    expect(await page.locator(".welcome progress").isVisible()).toBe(true);
    expect(await page.locator(".welcome button").isVisible()).toBe(false);
    release();
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
    expect(await page.locator(".welcome").isVisible()).toBe(false);
    expect(await page.evaluate(() => (globalThis as unknown as { shift: number }).shift)).toBeLessThan(0.01);
  });

  it("a host's problem is told, and trying again helps once it is over", async () => {
    let status = 503;
    page = await openWith(async () => status);
    await page.waitForSelector(".welcome h1:text-is('This bundle cannot be shown')");
    await page.waitForSelector("[data-problem]:text('bundle.server_failed')");
    status = 401;
    await page.click("text=Try again");
    await page.waitForSelector("[data-problem]:text('bundle.login_needed')");
    expect(await heading()).toBe("This bundle cannot be shown");
    status = 200;
    await page.click("text=Try again");
    await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer?.bundle != null);
    await page.waitForSelector(".message:empty", { state: "attached" });
  });
});
