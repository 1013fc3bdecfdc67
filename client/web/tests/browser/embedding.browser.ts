import type { Page } from "playwright-core";
import { afterEach, describe, expect, inject, it } from "vitest";
import { closePages, sharedChromium } from "../support/chromium.js";
import { mostSeats } from "../../src/viewer/seats.js";
import { fixedView, openViewer } from "./support.js";

type Told = { readonly told: [string, Record<string, unknown>][] };

const browser = await sharedChromium();
/** Warnings of the browser, such as of too many contexts. */
const warnings: string[] = [];

afterEach(() => closePages(browser));

/** Open another site's page with some elements. */
async function open(
  parameters: Record<string, string>,
  viewport = { width: 800, height: 600 },
): Promise<Page> {
  const page = await browser.newPage({ viewport });
  page.on("console", (message) => {
    if (message.type() !== "log") warnings.push(message.text());
  });
  await page.goto(`${inject("site")}/pages/twelve.html?${new URLSearchParams(parameters)}`);
  await page.waitForSelector("lambent-viewer", { state: "attached" });
  return page;
}

const numDrawing = (page: Page): Promise<number> =>
  page.evaluate(
    () => [...document.querySelectorAll("lambent-viewer")].filter((each) => each.viewer !== null).length,
  );
const allShown = (page: Page): Promise<unknown> =>
  page.waitForFunction(() =>
    [...document.querySelectorAll("lambent-viewer")].every(
      ({ viewer }) => viewer === null || viewer.bundle !== null,
    ),
  );
/** Return the colour of a pixel of the window. */
async function pixelAt(page: Page, x: number, y: number): Promise<number[]> {
  const clip = { x, y, width: 1, height: 1 };
  const picture = (await page.screenshot({ clip })).toString("base64");
  const reader = await browser.newPage();
  const pixel = await reader.evaluate(async (text) => {
    const image = new Image();
    image.src = `data:image/png;base64,${text}`;
    await image.decode();
    const context = new OffscreenCanvas(1, 1).getContext("2d")!;
    context.drawImage(image, 0, 0);
    return [...context.getImageData(0, 0, 1, 1).data.subarray(0, 3)];
  }, picture);
  await reader.close();
  return pixel;
}

describe("twelve elements on a page", () => {
  it("share eight contexts, none of which is lost, and take turns", { timeout: 300_000 }, async () => {
    const page = await open({ count: "12" });
    await allShown(page);
    expect(await numDrawing(page)).toBe(mostSeats);
    const waiting = page.getByRole("button", { name: /^Show in 3D/ });
    expect(await waiting.count()).toBe(12 - mostSeats);
    const lost = (): Promise<boolean[]> =>
      page.evaluate(() =>
        [...document.querySelectorAll("lambent-viewer")]
          .filter(({ viewer }) => viewer !== null)
          .map(({ viewer }) => viewer!.canvas.getContext("webgl2")!.isContextLost()),
      );
    expect(await lost()).toEqual(new Array(mostSeats).fill(false));
    // Everyone is used once, so that each has had a context: twenty in all.
    for (let index = 11; index >= 0; index--) {
      await page.evaluate((at) => document.querySelectorAll("lambent-viewer")[at]!.reveal(), index);
    }
    await allShown(page);
    expect(await numDrawing(page)).toBe(mostSeats);
    expect(await lost()).toEqual(new Array(mostSeats).fill(false));
    // Those that were used first rest, with the picture that they had if they had one.
    const drawing = await page.evaluate(() =>
      [...document.querySelectorAll("lambent-viewer")].map(({ viewer }) => viewer !== null),
    );
    expect(drawing).toEqual([...new Array(8).fill(true), ...new Array(4).fill(false)]);
    expect(warnings.filter((text) => /context/i.test(text))).toEqual([]);
  });

  it("that rest keep their picture and their state, and continue from there", async () => {
    const page = await open({ count: "9" });
    await allShown(page);
    await page.evaluate(async () => {
      const first = document.querySelector("lambent-viewer")!;
      await first.update({ pose: { ...first.state.pose, azimuthDeg: 77 } });
      for (const each of [...document.querySelectorAll("lambent-viewer")].slice(1)) each.reveal();
    });
    const first = page.locator("lambent-viewer").first();
    expect(await first.evaluate((each: HTMLElementTagNameMap["lambent-viewer"]) => each.viewer)).toBeNull();
    expect(await first.locator(".poster canvas").isVisible()).toBe(true);
    await allShown(page);
    await first.getByRole("button", { name: "Show in 3D: Object 0" }).click();
    await allShown(page);
    const state = await first.evaluate((each: HTMLElementTagNameMap["lambent-viewer"]) => each.state);
    expect(state.pose.azimuthDeg).toBe(77);
    await first.locator(".poster").waitFor({ state: "hidden" });
    expect(await numDrawing(page)).toBe(mostSeats);
  });
});

describe("an element that shows dropped files", () => {
  it("shows them again after a rest, and not what could not be shown", { timeout: 300_000 }, async () => {
    const page = await open({ count: String(mostSeats + 1) });
    await allShown(page);
    const first = page.locator("lambent-viewer").first();
    const drop = (name: string, address: string | null): Promise<void> =>
      first.evaluate(
        async (element: HTMLElement, given) => {
          const data = given.address === null ? "no archive" : await (await fetch(given.address)).blob();
          const transfer = new DataTransfer();
          transfer.items.add(new File([data], given.name));
          element.dispatchEvent(
            new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }),
          );
        },
        { name, address },
      );
    const shown = (): Promise<string | undefined> =>
      first.evaluate((each: HTMLElementTagNameMap["lambent-viewer"]) => each.viewer?.bundle?.name);
    const before = await shown();
    await drop("ball.relight.zip", "/data/golden/ball.relight.zip");
    await expect.poll(shown, { timeout: 30_000 }).not.toBe(before);
    const dropped = await shown();
    await drop("broken.relight.zip", null);
    await first.locator("[data-problem]").waitFor();
    expect(await shown()).toBe(dropped);
    await page.evaluate(() => {
      for (const each of [...document.querySelectorAll("lambent-viewer")].slice(1)) each.reveal();
    });
    await expect.poll(shown).toBeUndefined();
    await first.getByRole("button", { name: "Show in 3D: Object 0" }).click();
    await expect.poll(shown, { timeout: 30_000 }).toBe(dropped);
  });
});

describe("an element that works in a dialog", () => {
  it("continues to draw while others would like its context", { timeout: 300_000 }, async () => {
    const page = await open({ count: String(mostSeats + 1), controls: "" });
    await allShown(page);
    const first = page.locator("lambent-viewer").first();
    const isDrawing = (): Promise<boolean> =>
      first.evaluate((each: HTMLElementTagNameMap["lambent-viewer"]) => each.viewer !== null);
    /** Use all others, so that the first one is the one whose use is longest ago. */
    const useOthers = (): Promise<void> =>
      page.evaluate(() => {
        for (const each of [...document.querySelectorAll("lambent-viewer")].slice(1)) each.reveal();
      });
    const press = (text: string): Promise<void> =>
      first.evaluate((element: HTMLElement, wanted) => {
        const buttons = [...element.shadowRoot!.querySelectorAll("button")];
        buttons.find(({ textContent }) => textContent === wanted)!.click();
      }, text);
    await first.evaluate(async (element: HTMLElementTagNameMap["lambent-viewer"]) => {
      element.viewer!.refineOptions = { ...element.viewer!.refineOptions, workers: 1 };
      await element.update({ refine: true });
    });
    await press("Save PNG");
    const still = page.getByRole("dialog", { name: "Refining a picture" });
    await still.getByText(/Part \d+ of/).waitFor();
    await useOthers();
    expect(await isDrawing()).toBe(true);
    await press("Cancel");
    await still.waitFor({ state: "detached" });
    await press("Make a film…");
    const film = page.getByRole("dialog", { name: "Make a film" });
    await film.getByLabel("Size").selectOption({ label: "Another size" });
    await film.getByLabel("Width").fill("160");
    await film.getByLabel("Height").fill("120");
    await film.getByLabel("Seconds").fill("60");
    await film.getByRole("button", { name: "Make the film" }).click();
    await film.getByText(/Frame \d+ of/).waitFor();
    await useOthers();
    expect(await isDrawing()).toBe(true);
    await press("Cancel");
    await film.getByText("nothing was saved").waitFor();
    await useOthers();
    expect(await isDrawing()).toBe(false);
  });
});

describe("an element on another site's page", () => {
  it("lets the page be seen behind the object, and has a pattern there on its own page", async () => {
    const page = await open({ count: "1", state: "env=preset:even&background=transparent&rotate=0,0,0" });
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
    await page.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.drawNow(2));
    expect(await pixelAt(page, 3, 3)).toEqual([10, 200, 60]);
    const own = await openViewer(browser, { ...fixedView, env: "preset:even", background: "transparent" });
    await own.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.drawNow(2));
    const pattern = await pixelAt(own, 3, 3);
    expect(Math.max(...pattern)).toBeLessThan(60);
  });

  it("leaves the wheel to the page until someone uses it, and then zooms", async () => {
    const page = await open({ count: "2", tall: "" }, { width: 400, height: 600 });
    await allShown(page);
    const now = (): Promise<{ scroll: number; distance: number }> =>
      page.evaluate(() => ({
        scroll: scrollY,
        distance: document.querySelector("lambent-viewer")!.state.pose.distance,
      }));
    const first = await now();
    await page.mouse.move(200, 150);
    await page.mouse.wheel(0, 60);
    await page.waitForFunction(() => scrollY > 0);
    expect((await now()).distance).toBe(first.distance);
    // The browser keeps a gesture of the wheel, and its animation, with what it began to scroll.
    await page.waitForTimeout(1000);
    await page.evaluate(() => scrollTo(0, 0));
    await page.waitForFunction(() => scrollY === 0);
    await page.keyboard.down("Control");
    await page.mouse.wheel(0, 60);
    await page.keyboard.up("Control");
    await page.waitForFunction(
      (before) => document.querySelector("lambent-viewer")!.state.pose.distance > before,
      first.distance,
    );
    const second = await now();
    await page.mouse.click(200, 150);
    await page.mouse.wheel(0, 60);
    await page.waitForFunction(
      (before) => document.querySelector("lambent-viewer")!.state.pose.distance > before,
      second.distance,
    );
    expect((await now()).scroll).toBe(0);
    const touch = (): Promise<string> =>
      page.evaluate(
        () =>
          getComputedStyle(document.querySelector("lambent-viewer")!.shadowRoot!.querySelector("canvas")!)
            .touchAction,
      );
    expect(await touch()).toBe("pan-y");
    await page.evaluate(() => document.querySelector("lambent-viewer")!.toggleAttribute("fullpage"));
    expect(await touch()).toBe("none");
  });

  it("loads when it comes into view, and shows its poster until then", async () => {
    const poster = "/data/bundle/preview/photo_turntable_000.png";
    const page = await open({ count: "2", tall: "", loading: "lazy", poster }, { width: 400, height: 600 });
    const asked: string[] = [];
    page.on("request", (request) => asked.push(request.url()));
    await page.waitForFunction(() => document.querySelector("lambent-viewer")!.viewer?.bundle != null);
    const second = page.locator("lambent-viewer").nth(1);
    expect(await numDrawing(page)).toBe(1);
    expect(await second.locator(".poster img").isVisible()).toBe(true);
    await page.evaluate(() => scrollTo(0, 1000));
    await page.waitForFunction(() => document.querySelectorAll("lambent-viewer")[1]!.viewer?.bundle != null);
    await second.locator(".poster").waitFor({ state: "hidden" });
    await page.evaluate(() => document.querySelectorAll("lambent-viewer")[1]!.ready);
  });

  it("with reveal=manual loads when someone asks for it", async () => {
    const page = await open({ count: "1", reveal: "manual" });
    const show = page.getByRole("button", { name: "Show in 3D: Object 0" });
    await show.waitFor();
    expect(await numDrawing(page)).toBe(0);
    await show.click();
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
    expect(await numDrawing(page)).toBe(1);
  });

  it("tells what happens by events", async () => {
    const page = await open({ count: "1" });
    await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
    await page.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      const { pose, turn } = element.state;
      await element.update({ pose: { ...pose, azimuthDeg: 12 } });
      await element.update({ turn: { ...turn, yawDeg: 34 } });
      element.setAttribute("src", "/data/nothing/");
    });
    const told = () =>
      page.evaluate(() => (document.querySelector("lambent-viewer") as unknown as Told).told);
    await expect.poll(async () => (await told()).at(-1)![0]).toBe("error");
    const found = await told();
    const names = found.map(([name]) => name).filter((name) => name !== "progress");
    expect(names).toEqual(["load", "camera-change", "light-change", "error"]);
    expect(found[0]![0]).toBe("progress");
    expect(found.find(([name]) => name === "load")![1]).toEqual({ name: "analytic" });
    expect(found.find(([name]) => name === "camera-change")![1]).toMatchObject({ pose: { azimuthDeg: 12 } });
    expect(found.find(([name]) => name === "light-change")![1]).toMatchObject({ turn: { yawDeg: 34 } });
    expect(found.at(-1)![1]).toMatchObject({ code: "bundle.manifest_missing" });
  });
});
