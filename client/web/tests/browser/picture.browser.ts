import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { closePages, sharedChromium } from "../support/chromium.js";
import { expectedPictures, fixtureFile, keep, meanDifference, openViewer, pictureOf } from "./support.js";

let browser: Browser;
let page: Page;

beforeAll(async () => {
  browser = await sharedChromium();
  page = await openViewer(browser, { tone: "linear", background: "transparent" });
});
afterAll(() => closePages(browser));

describe("the picture", () => {
  const pictures = expectedPictures();

  it.each(pictures.map((each, index) => [index, `${each.map} turned by ${each.rotateDeg}`] as const))(
    "%i is Python's: %s",
    async (index) => {
      const expected = pictures[index]!;
      await page.evaluate(
        async ([{ rotateDeg, albedoGain, roughnessScale }, url]) => {
          const viewer = document.querySelector("lambent-viewer")!;
          const { turn, look } = viewer.state;
          await viewer.update({
            environment: `url:${url}`,
            turn: { ...turn, yawDeg: rotateDeg },
            look: { ...look, edit: { albedoGain, roughnessScale, metalnessShift: 0 } },
          });
        },
        [expected, `data/${expected.map}`] as const,
      );
      const found = await pictureOf(page, expected.camera);
      const reference = Uint8Array.from(fixtureFile(expected.file));
      const difference = meanDifference(found, reference);
      keep(`python_${index}`, reference, expected.camera.width);
      keep(`browser_${index}`, found, expected.camera.width);
      console.log(`picture ${index}: mean difference ${difference.toFixed(3)} / 255`);
      expect(difference).toBeLessThanOrEqual(2);
    },
  );
});
