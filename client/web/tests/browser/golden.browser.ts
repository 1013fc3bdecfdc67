import { describe, expect, it } from "vitest";
import type { ViewCamera } from "../../src/render/looks.js";
import { sharedChromium } from "../support/chromium.js";
import { fixedView, fixtureFile, keep, meanDifference, openViewer, pictureOf } from "./support.js";

type Golden = { readonly bundle: string; readonly picture: string; readonly camera: ViewCamera };
const browser = await sharedChromium();

/** Return the pixels away from outlines, which Python's pictures have from the networks and ours from the mesh. */
function inside(rgba: Uint8Array, { width, height }: ViewCamera): Uint8Array {
  const covered = (row: number, column: number): boolean =>
    row >= 0 && row < height && column >= 0 && column < width && rgba[4 * (row * width + column) + 3]! > 250;
  const around = [-1, 0, 1].flatMap((row) => [-1, 0, 1].map((column) => [row, column] as const));
  return Uint8Array.from({ length: width * height }, (_, pixel) => {
    const [row, column] = [Math.floor(pixel / width), pixel % width];
    return around.every(([down, right]) => covered(row + down, column + right)) ? 1 : 0;
  });
}

describe("a golden bundle", () => {
  const all = JSON.parse(fixtureFile("golden.json").toString()) as Golden[];

  it.each(all)("is drawn as ever: $bundle", async ({ bundle, picture, camera }) => {
    const page = await openViewer(
      browser,
      { ...fixedView, tone: "linear", background: "transparent" },
      `data/${bundle}`,
    );
    await page.evaluate(() =>
      document.querySelector("lambent-viewer")!.update({ environment: "url:data/golden.exr" }),
    );
    const found = await pictureOf(page, camera, 1);
    const expected = Uint8Array.from(fixtureFile(picture));
    const name = bundle.replace(/\W/g, "_");
    keep(`golden_expected_${name}`, expected, camera.width);
    keep(`golden_found_${name}`, found, camera.width);
    const kept = inside(expected, camera);
    expect(kept.filter((one) => one).length).toBeGreaterThan(8);
    const only = (rgba: Uint8Array): Uint8Array => rgba.filter((_, index) => kept[index >> 2]);
    const difference = meanDifference(only(found), only(expected));
    console.log(`${bundle}: mean difference ${difference.toFixed(3)} / 255`);
    expect(difference).toBeLessThanOrEqual(2);
    await page.close();
  });
});
