import type { Page } from "playwright-core";
import { describe, expect, inject, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { serveFolders } from "../support/server.js";
import { fixedView, fixtureFile, meanDifference, openViewer, pictureOf } from "./support.js";

const browser = await sharedChromium();
let page: Page;

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

  it("the object is shown with the first planes of its transport, and finer once all of them are there", async () => {
    let release = (): void => {};
    const held = new Promise<void>((resolve) => {
      release = resolve;
    });
    const sent = new Map<string, number>();
    const folders = { "": inject("pages"), data: inject("fixture") };
    const site = await serveFolders(folders, {
      gzip: true,
      piece: async (path, bytes, share) => {
        sent.set(path, (sent.get(path) ?? 0) + bytes);
        if (/\/direct_sh\d\.bin$/.test(path) && share > 0.9) await held;
      },
    });
    const look = { ...fixedView, env: "preset:sunset", tone: "linear" };
    page = await openViewer(browser, look, null, undefined, site.url);
    await page.evaluate((src) => {
      const element = document.querySelector("lambent-viewer")!;
      element.addEventListener("load", () => element.setAttribute("data-shown", ""));
      element.setAttribute("src", src);
      element.ready.then(() => element.setAttribute("data-whole", ""));
    }, `${site.url}/data/bundle/`);
    await page.waitForSelector("lambent-viewer[data-shown]");
    expect(await page.locator("lambent-viewer[data-whole]").count()).toBe(0);
    const size = { width: 160, height: 120 };
    const first = await pictureOf(page, size);
    release();
    await page.waitForSelector("lambent-viewer[data-whole]");
    const whole = await pictureOf(page, size);
    const apart = meanDifference(first, whole);
    expect(apart).toBeGreaterThan(0.01);
    expect(apart).toBeLessThan(3);
    await page.close();
    const files = [...sent].filter(([path]) => path.startsWith("data/bundle/"));
    const sizes = files.map(([path]) => fixtureFile(path.slice("data/".length)).length);
    const total = (values: number[]): number => values.reduce((sum, value) => sum + value, 0);
    expect(total(files.map(([, bytes]) => bytes))).toBeLessThan(0.9 * total(sizes));
    await site.close();
    // As if everything had come at once.
    const other = await openViewer(browser, look, "data/bundle.relight.zip");
    expect(meanDifference(await pictureOf(other, size), whole)).toBe(0);
    await other.close();
  });

  it("a host's problem is shown, and trying again helps once it is over", async () => {
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

describe("pictures of a bundle", () => {
  it("are closed when another one is shown, and with the element", async () => {
    page = await openViewer(browser, {}, "data/golden/ball.relight.zip");
    const widths = (change: "open" | "leave") =>
      page.evaluate(async (what) => {
        const element = document.querySelector("lambent-viewer")!;
        const { maps, unseen } = element.viewer!.bundle!;
        const all = [maps!.albedo, maps!.packed, maps!.normal, ...(unseen === null ? [] : [unseen])];
        const before = Math.max(...all.map(({ width }) => width));
        if (what === "open") await element.show("data/golden/ball.relight.zip");
        else element.remove();
        return [before, ...all.map(({ width }) => width)];
      }, change);
    for (const change of ["open", "leave"] as const) {
      const [before, ...after] = await widths(change);
      expect(before).toBeGreaterThan(1);
      expect(after.every((width) => width === 0)).toBe(true);
    }
  });
});

describe("the controls", () => {
  const isVisible = (selector: string): Promise<boolean> => page.locator(selector).isVisible();
  const open = (src: string): Promise<string> =>
    page.evaluate(
      (address) =>
        document
          .querySelector("lambent-viewer")!
          .show(address)
          .then(
            () => "shown",
            (error: Error) => error.message,
          ),
      src,
    );

  it("are there with a bundle that gave way, before it was lit, to one that cannot be shown", async () => {
    let release = (): void => {};
    const held = new Promise<void>((resolve) => {
      release = resolve;
    });
    page = await openViewer(browser, { ...fixedView, env: `url:${inject("site")}/data/spots.exr` }, null);
    await page.route("**/spots.exr", async (route) => {
      await held;
      await route.continue();
    });
    const first = open("data/bundle/");
    await page.waitForFunction(() => document.querySelector("lambent-viewer")!.viewer!.bundle !== null);
    expect(await isVisible(".welcome")).toBe(true);
    expect(await open("data/nothing/")).toContain("manifest.json");
    release();
    expect(await first).toContain("another bundle");
    expect([await isVisible(".welcome"), await isVisible(".chips")]).toEqual([false, true]);
  });

  it("go with a bundle that the card has no memory for, and come with the next one", async () => {
    page = await openViewer(browser);
    await page.evaluate(() => {
      const card = WebGL2RenderingContext.prototype;
      const plain = card.getError;
      let times = 0;
      card.getError = () => (times++ === 0 ? WebGL2RenderingContext.OUT_OF_MEMORY : 0);
      Object.assign(globalThis, {
        repair: () => {
          card.getError = plain;
        },
      });
    });
    expect(await open("data/bundle/")).toContain("enough memory");
    await page.waitForSelector(".welcome h1:text-is('This bundle cannot be shown')");
    expect(await isVisible(".dock")).toBe(false);
    await page.evaluate(() => (globalThis as unknown as { repair: () => void }).repair());
    expect(await open("data/bundle/")).toBe("shown");
    expect([await isVisible(".welcome"), await isVisible(".dock")]).toEqual([false, true]);
  });
});
