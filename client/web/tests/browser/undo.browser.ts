import type { Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { change, openViewer, stateOf } from "./support.js";

const browser = await sharedChromium();
let page: Page;

const state = () => stateOf(page);
const update = (part: object) => change(page, part);
const told = () => new URLSearchParams(new URL(page.url()).hash.slice(1));

async function drag(across: number): Promise<void> {
  await page.mouse.move(300, 250);
  await page.mouse.down();
  for (let step = 1; step <= 4; step++) await page.mouse.move(300 + (across * step) / 4, 250);
  await page.mouse.up();
}

beforeAll(async () => {
  const context = await browser.newContext({
    viewport: { width: 900, height: 600 },
    reducedMotion: "reduce",
  });
  page = await openViewer(context, { env: "preset:studio", rotate: "0,0,0" });
});

describe("the page's address", () => {
  it("follows what is shown, and loading it again brings that back", async () => {
    const source = told().get("src");
    await drag(60);
    await update({
      environment: "preset:sky",
      turn: { yawDeg: 25, pitchDeg: 5, rollDeg: 0, intensity: 1.5 },
    });
    await expect.poll(() => told().get("rotate")).toBe("25,5,0");
    expect([told().get("env"), told().get("src")]).toEqual(["preset:sky", source]);
    const [before, length] = [await state(), await page.evaluate(() => history.length)];
    await page.reload();
    await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer?.bundle != null);
    await page.evaluate(async () => {
      await document.querySelector("lambent-viewer")!.ready;
      // A page hears nobody before its first frame.
      await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
    });
    const after = await state();
    expect({ ...after, pose: null }).toEqual({ ...before, pose: null });
    expect(after.pose.azimuthDeg).toBeCloseTo(before.pose.azimuthDeg, 2);
    expect(await page.evaluate(() => history.length)).toBe(length);
  });
});

describe("undo", () => {
  const names = (list: readonly string[]) =>
    page.locator(list.map((each) => `button:text-is('${each}')`).join());

  it("takes back drags, lights and settings, one by one, by keys and buttons", async () => {
    const first = await state();
    await drag(80);
    await drag(-30);
    const dragged = await state();
    await update({ environment: "preset:even" });
    await update({ look: { ...dragged.look, tone: "agx" } });
    const last = await state();
    await page.keyboard.press("Control+z");
    expect((await state()).look).toEqual(dragged.look);
    await page.getByRole("button", { name: "Undo" }).click();
    expect((await state()).environment).toBe("preset:sky");
    await page.keyboard.press("Control+z");
    const between = (await state()).pose.azimuthDeg;
    expect(between).not.toBe(dragged.pose.azimuthDeg);
    await page.keyboard.press("Control+z");
    expect(await state()).toEqual(first);
    for (let times = 0; times < 3; times++) await page.keyboard.press("Control+Shift+Z");
    await page.getByRole("button", { name: "Redo" }).click();
    expect(await state()).toEqual(last);
    expect(await page.getByRole("button", { name: "Redo" }).getAttribute("aria-disabled")).toBe("true");
  });

  it("of a number that is typed is the field's own", async () => {
    const before = await state();
    await page.getByLabel("Exposure (EV), as a number").focus();
    await page.keyboard.press("Control+z");
    expect(await state()).toEqual(before);
  });

  it("brings back what a reset has put back, and each reset is of its own part", async () => {
    await page.evaluate(() => {
      for (const part of document.querySelector("lambent-viewer")!.shadowRoot!.querySelectorAll("details")) {
        part.open = true;
      }
    });
    await update({ turn: { yawDeg: 40, pitchDeg: 5, rollDeg: 0, intensity: 1.5 } });
    const before = await state();
    await names(["Reset light"]).click();
    const after = await state();
    // As it stood for the first view.
    expect(after.turn).toEqual({ yawDeg: 25, pitchDeg: 0, rollDeg: 0, intensity: 1 });
    expect({ ...after, turn: before.turn }).toEqual(before);
    await names(["Reset camera"]).click();
    expect((await state()).pose).not.toEqual(before.pose);
    await page.keyboard.press("Control+z");
    await page.keyboard.press("Control+z");
    expect(await state()).toEqual(before);
  });
});
