import type { Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { change, expectedPictures, fixedView, meanDifference, openViewer, pictureOf } from "./support.js";

const size = { width: 96, height: 72 };
const browser = await sharedChromium();
let page: Page;

const update = (part: object) => change(page, part);

beforeAll(async () => {
  page = await openViewer(browser, { ...fixedView, env: "preset:studio" }, "data/bundle/", {
    width: 480,
    height: 360,
  });
});

describe("comparisons", () => {
  it("show two lights beside each other", async () => {
    const whole = { compare: "off", environment: "preset:studio" };
    await update(whole);
    const left = await pictureOf(page, size, 1);
    await update({ ...whole, environment: "preset:even" });
    const right = await pictureOf(page, size, 1);
    await update({ ...whole, compare: "environment", environmentB: "preset:even", split: 0.5 });
    const both = await pictureOf(page, size, 1);
    const half = (picture: Uint8Array, first: number): Uint8Array =>
      picture.filter((_, index) => Math.floor(index / 4) % size.width >= 48 === first >= 48);
    expect(meanDifference(half(both, 0), half(left, 0))).toBe(0);
    expect(meanDifference(half(both, 48), half(right, 48))).toBe(0);
    expect(meanDifference(half(both, 48), half(left, 48))).toBeGreaterThan(2);
    const labels = await page.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      const middle = root.querySelector(".split")!.getBoundingClientRect().left;
      return [...root.querySelectorAll(".sides span")].map((label) => {
        const { left: from, right: to } = label.getBoundingClientRect();
        return [label.textContent, to < middle ? "left" : from > middle ? "right" : "across"];
      });
    });
    expect(labels).toEqual([
      ["Studio", "left"],
      ["Even grey", "right"],
    ]);
  });

  it("have one exposure, that of the light on the left", async () => {
    const { look } = await page.evaluate(() => document.querySelector("lambent-viewer")!.state);
    const bright = { ...look, autoExposure: true };
    const right = (picture: Uint8Array) => picture.filter((_, at) => Math.floor(at / 4) % size.width >= 48);
    await update({ compare: "off", environment: "preset:sky", look: bright });
    const ev = await page.evaluate(() => document.querySelector("lambent-viewer")!.viewer!.lightExposure);
    expect(ev).toBeLessThan(-0.5);
    await update({ environment: "preset:even", look: { ...look, exposureEv: ev } });
    const wanted = await pictureOf(page, size, 1);
    await update({
      compare: "environment",
      environment: "preset:sky",
      environmentB: "preset:even",
      look: bright,
    });
    const both = await pictureOf(page, size, 1);
    expect(meanDifference(right(both), right(wanted))).toBe(0);
    await update({ compare: "off", environment: "preset:studio", look });
  });

  it("show what plain image-based light leaves out", async () => {
    await update({ environment: "preset:studio", compare: "plain", split: 0 });
    const plain = await pictureOf(page, size, 1);
    await update({ compare: "off", split: 0.5 });
    expect(meanDifference(plain, await pictureOf(page, size, 1))).toBeGreaterThan(2);
  });
});

describe("a photograph", () => {
  it("is laid over the view from its own camera", async () => {
    const [first] = expectedPictures();
    await update({ compare: "photo", photo: "turntable_000", split: 0.25 });
    await page.waitForFunction(() => {
      const photo = document.querySelector("lambent-viewer")!.shadowRoot!.querySelector("img")!;
      return !photo.hidden && photo.complete && photo.naturalWidth === 256;
    });
    // The page is 480 x 360 without its controls' column: the photograph is square, in the middle.
    const box = await page.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      const [photo, view] = [root.querySelector("img")!, root.querySelector(".view")!];
      const [inner, outer] = [photo.getBoundingClientRect(), view.getBoundingClientRect()];
      return [inner.width - inner.height, inner.left + inner.right - outer.left - outer.right].map(
        Math.round,
      );
    });
    expect(box).toEqual([0, 0]);
    const { width, height } = first!.camera;
    const seen = await pictureOf(page, { width, height }, 1);
    expect(meanDifference(seen, await pictureOf(page, first!.camera, 1))).toBe(0);
    await update({ compare: "off", split: 0.5 });
  });
  it("has the relit object beside it on its own background, without tone curve or exposure of the light", async () => {
    const { look } = await page.evaluate(() => document.querySelector("lambent-viewer")!.state);
    // The fixture's photographs are over black.
    const wanted = { ...look, tone: "linear", background: "colour", backgroundSrgb: [0, 0, 0] };
    await update({ look: wanted });
    const camera = expectedPictures()[0]!.camera;
    const matched = await pictureOf(page, camera, 1);
    await update({ look: { ...look, tone: "agx", background: "blurred", autoExposure: true } });
    expect(meanDifference(await pictureOf(page, camera, 1), matched)).toBeGreaterThan(10);
    await update({ compare: "photo", photo: "turntable_001" });
    await update({ photo: "turntable_000" });
    const away = async () => meanDifference(await pictureOf(page, camera, 1), matched);
    await expect.poll(away, { timeout: 20_000 }).toBe(0);
    await update({ compare: "off", look });
  });
});
