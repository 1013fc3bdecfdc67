import type { Page } from "playwright-core";
import { beforeAll, describe, expect, inject, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { fixtureFile, openViewer, soon, stateOf } from "./support.js";

const browser = await sharedChromium();
let page: Page;

const state = () => stateOf(page);
const chips = () =>
  page.evaluate(() =>
    [
      ...document.querySelector("lambent-viewer")!.shadowRoot!.querySelectorAll<HTMLButtonElement>(".chip"),
    ].map((chip) => {
      const canvas = chip.querySelector("canvas");
      const middle = canvas?.getContext("2d")?.getImageData(48, 40, 1, 1).data;
      return { name: chip.textContent, pressed: chip.ariaPressed, painted: (middle?.[3] ?? 0) > 0 };
    }),
  );
const focused = () =>
  page.evaluate(() => document.querySelector("lambent-viewer")!.shadowRoot!.activeElement?.textContent);

beforeAll(async () => {
  const context = await browser.newContext({ viewport: { width: 900, height: 600 } });
  await context.addInitScript(() => {
    Object.assign(globalThis, { painted: 0 });
    const { prototype } = CanvasRenderingContext2D;
    const put = prototype.putImageData as (...given: unknown[]) => void;
    prototype.putImageData = function (this: CanvasRenderingContext2D, ...given: unknown[]) {
      (globalThis as unknown as { painted: number }).painted++;
      put.apply(this, given);
    } as typeof prototype.putImageData;
  });
  page = await openViewer(context, { env: "preset:studio", rotate: "0,0,0" });
});

describe("the row of lights", () => {
  it("shows each of them as a ball, and which one is chosen", async () => {
    await soon(async () => (await chips()).filter(({ painted }) => painted).length).toBe(5);
    const found = await chips();
    expect(found.map(({ name }) => name)).toEqual([
      "Softboxes",
      "Studio",
      "Clear sky",
      "Low sun",
      "Even grey",
      "+Add a light",
    ]);
    expect(found.filter(({ pressed }) => pressed === "true").map(({ name }) => name)).toEqual(["Studio"]);
    // Nothing is painted twice.
    expect(await page.evaluate(() => (globalThis as unknown as { painted: number }).painted)).toBe(5);
  });

  it("is one stop of the Tab key; arrows go along it, and Enter chooses", async () => {
    await page.getByRole("button", { name: "Studio" }).focus();
    await page.keyboard.press("ArrowRight");
    expect(await focused()).toBe("Clear sky");
    expect((await state()).environment).toBe("preset:studio");
    await page.keyboard.press("Enter");
    await soon(async () => (await state()).environment).toBe("preset:sky");
    await page.keyboard.press("End");
    expect(await focused()).toBe("+Add a light");
    await page.keyboard.press("ArrowRight");
    expect(await focused()).toBe("Softboxes");
    await page.keyboard.press("ArrowRight");
    expect(await focused()).toBe("Studio");
    await page.keyboard.press("Tab");
    const next = await page.evaluate(
      () => document.querySelector("lambent-viewer")!.shadowRoot!.activeElement?.role,
    );
    expect(next).toBe("slider");
  });

  it("takes maps from addresses and files, and shows them, too", async () => {
    await page.getByRole("button", { name: "Add a light" }).click();
    await page.getByLabel("Or from an address").fill(`${inject("site")}/data/spots.exr`);
    await page.keyboard.press("Enter");
    await soon(async () => (await state()).environment).toMatch(/^url:.*spots\.exr$/);
    await soon(async () => (await chips()).at(-2)).toEqual({
      name: "spots.exr",
      pressed: "true",
      painted: true,
    });
    await page.getByRole("button", { name: "Add a light" }).click();
    const [chooser] = await Promise.all([
      page.waitForEvent("filechooser"),
      page.getByRole("button", { name: "Open a .hdr or .exr map…" }).click(),
    ]);
    await chooser.setFiles([
      { name: "low.hdr", mimeType: "image/vnd.radiance", buffer: fixtureFile("sunset.hdr") },
    ]);
    await soon(async () => (await state()).environment).toBe("file:low.hdr");
    await page.getByRole("button", { name: "Studio" }).click();
    // Both stay in the row.
    const names = async () => (await chips()).map(({ name }) => name);
    await soon(names).toContain("low.hdr");
    expect(await names()).toContain("spots.exr");
    await soon(async () => (await chips()).filter(({ painted }) => painted).length).toBe(7);
  });

  it("closes what adds a light with Escape", async () => {
    await page.getByRole("button", { name: "Add a light" }).click();
    expect(await page.getByLabel("Or from an address").isVisible()).toBe(true);
    await page.keyboard.press("Escape");
    expect(await page.getByLabel("Or from an address").isVisible()).toBe(false);
    expect(await focused()).toBe("+Add a light");
  });
});

describe("the ball that shows the direction of the light", () => {
  const ball = () => page.getByRole("slider", { name: "Direction of the light" });

  it("turns the light where it is dragged to, as one change", async () => {
    await page.getByRole("button", { name: "Clear sky" }).click();
    await soon(async () => (await state()).environment).toBe("preset:sky");
    const before = await state();
    await soon(() => ball().getAttribute("aria-valuetext")).toMatch(
      /^azimuth 30 degrees, elevation (49|50|51) degrees$/,
    );
    const { x, y, width, height } = (await ball().boundingBox())!;
    await page.mouse.move(x + width / 2, y + height / 2);
    await page.mouse.down();
    for (let step = 1; step <= 6; step++) await page.mouse.move(x + width / 2 + 3 * step, y + height / 2);
    await page.mouse.up();
    const across = (await state()).turn;
    expect(across.yawDeg).toBeGreaterThan(30);
    expect([across.pitchDeg, across.rollDeg].map((value) => Math.abs(Math.round(value)))).toEqual([0, 0]);
    expect((await state()).pose).toEqual(before.pose);
    await page.keyboard.press("Control+z");
    expect((await state()).turn).toEqual(before.turn);
  });

  it("lets the light go where something took the pointer away", async () => {
    const { x, y, width, height } = (await ball().boundingBox())!;
    await page.mouse.move(x + width / 2, y + height / 2);
    await page.mouse.down();
    await page.mouse.move(x + width / 2 + 6, y + height / 2);
    await ball().evaluate((element) => element.releasePointerCapture(1));
    const { turn } = await state();
    await page.mouse.move(x + width / 2 + 12, y + height / 2);
    expect((await state()).turn).toEqual(turn);
    await page.mouse.up();
    await page.keyboard.press("Control+z");
  });

  it("turns it by arrow keys, and back with Home or two clicks", async () => {
    await ball().focus();
    await page.keyboard.press("ArrowRight");
    expect((await state()).turn.yawDeg).toBeCloseTo(5, 6);
    expect(await ball().getAttribute("aria-valuenow")).toBe("35");
    await page.keyboard.press("Home");
    await page.keyboard.press("ArrowDown");
    expect(await ball().getAttribute("aria-valuetext")).toMatch(/elevation 4[456] degrees$/);
    expect((await state()).turn.pitchDeg).not.toBe(0);
    await ball().dblclick();
    expect((await state()).turn).toEqual({ yawDeg: 25, pitchDeg: 0, rollDeg: 0, intensity: 1 });
  });
});
