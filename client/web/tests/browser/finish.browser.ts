import type { Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { expectedPictures, fixedView, openViewer, pictureOf } from "./support.js";

const browser = await sharedChromium();
let page: Page;

beforeAll(async () => {
  page = await openViewer(browser, { ...fixedView, env: "preset:studio", background: "blurred" });
});

const show = (background: "blurred" | "colour" | "transparent") =>
  page.evaluate(async (asked) => {
    const viewer = document.querySelector("lambent-viewer")!;
    await viewer.update({ look: { ...viewer.state.look, background: asked } });
  }, background);

describe("a picture of 8 bits", () => {
  it("is dithered by up to one code value where something is shaded, and is the same on average", async () => {
    await show("blurred");
    const { camera } = expectedPictures()[0]!;
    const [plain, noisy] = [await pictureOf(page, camera), await pictureOf(page, camera, 2, true)];
    let [sum, squares, most] = [0, 0, 0];
    plain.forEach((value, index) => {
      const away = noisy[index]! - value;
      if (index % 4 === 3) expect(away).toBe(0);
      sum += away;
      squares += away ** 2;
      most = Math.max(most, Math.abs(away));
    });
    const values = 0.75 * plain.length;
    expect(most).toBeLessThanOrEqual(2);
    expect(Math.abs(sum / values)).toBeLessThan(0.01);
    // Noise of a sixth of a code value's square, and rounding before and after it.
    expect(squares / values).toBeGreaterThan(0.15);
    expect(squares / values).toBeLessThan(0.5);
  });

  it("keeps a plain background as it was asked for", async () => {
    await show("colour");
    const noisy = await pictureOf(page, { width: 64, height: 48 }, 2, true);
    expect([...noisy.subarray(0, 3)]).toEqual([237, 237, 237]);
    expect([...noisy.subarray(4 * 40, 4 * 40 + 3)]).toEqual([237, 237, 237]);
  });

  it("has smooth borders also with one sample to a pixel", async () => {
    await show("transparent");
    const { camera } = expectedPictures()[0]!;
    const [quick, fine] = [await pictureOf(page, camera, 1), await pictureOf(page, camera, 4)];
    const levels = new Set<number>();
    let [difference, border] = [0, 0];
    for (let index = 3; index < quick.length; index += 4) {
      levels.add(quick[index]!);
      if (fine[index] === 0 || fine[index] === 255) continue;
      border++;
      difference += Math.abs(quick[index]! - fine[index]!) / 255;
    }
    expect([...levels].sort((a, b) => a - b)).toEqual([0, 64, 128, 191, 255]);
    expect(border).toBeGreaterThan(200);
    // With no more than one sample the mean difference is a quarter.
    expect(difference / border).toBeLessThan(0.13);
  });
});
