import { describe, expect, it } from "vitest";
import type { RefinedPicture } from "../src/refine/accumulation.js";
import { bakedError, refinedShares } from "../src/refine/blending.js";
import { Randoms } from "../src/refine/randoms.js";

const [width, height] = [9, 7];

/** A picture of some radiance, with errors that are `noise` of it, and a border that shows nothing. */
function picture(noise: number, seed = 1): RefinedPicture {
  const randoms = new Randoms();
  randoms.begin(seed, 0, 0);
  const rgb = (scale: number) =>
    Float32Array.from({ length: 3 * width * height }, () => scale * randoms.next());
  const [directRgb, indirectRgb] = [rgb(2), rgb(0.5)];
  return {
    ...{ width, height, directRgb, indirectRgb },
    standardErrorRgb: directRgb.map((value, index) => noise * (value + indirectRgb[index]!)),
    visibility: new Float32Array(width * height),
    coverage: Float32Array.from({ length: width * height }, (_, pixel) => (pixel % width < 2 ? 0 : 0.75)),
    ...{ samplesPerPixel: 16, relativeError: noise },
  };
}

describe("the share of a refined picture", () => {
  it("is by the inverse variance of what is around, and nothing where nothing is refined", () => {
    const given = picture(0.3);
    const shares = refinedShares(given, false);
    for (let row = 0; row < height; row++) {
      for (let column = 0; column < width; column++) {
        const around: number[] = [];
        for (let pixel = 0; pixel < width * height; pixel++) {
          const [i, j] = [Math.floor(pixel / width), pixel % width];
          if (Math.abs(i - row) <= 1 && Math.abs(j - column) <= 1 && j >= 2) around.push(pixel);
        }
        const mean = (of: (index: number) => number): number =>
          around
            .flatMap((pixel) => [0, 1, 2].map((channel) => of(3 * pixel + channel)))
            .reduce((a, b) => a + b, 0) /
          (3 * around.length);
        const pixel = row * width + column;
        const own = [0, 1, 2].reduce((sum, c) => sum + given.standardErrorRgb[3 * pixel + c]! ** 2, 0) / 3;
        const variance = Math.max(
          mean((index) => given.standardErrorRgb[index]! ** 2),
          own,
        );
        const radiance = mean((index) => given.directRgb[index]! + given.indirectRgb[index]!);
        const [refined, baked] = [1 / (variance / radiance ** 2), 1 / bakedError ** 2];
        const wanted = column < 2 ? 0 : refined / (refined + baked);
        expect(shares[pixel]).toBeCloseTo(wanted, 6);
      }
    }
  });

  it("grows as noise goes, is all of it without noise, and is larger where noise was smoothed", () => {
    const mean = (noise: number, smoothed: boolean): number => {
      const shares = refinedShares(picture(noise), smoothed).filter((share) => share > 0);
      return shares.reduce((a, b) => a + b, 0) / shares.length;
    };
    expect(mean(0, false)).toBe(1);
    const [loud, quiet] = [mean(0.5, false), mean(0.02, false)];
    expect(loud).toBeLessThan(0.1);
    expect(quiet).toBeGreaterThan(0.9);
    expect(mean(0.5, true)).toBeGreaterThan(2 * loud);
  });

  it("is small at a single bright pixel, whatever is around", () => {
    const given = picture(0.05);
    const pixel = 3 * width + 5;
    const before = refinedShares(given, true);
    given.standardErrorRgb.fill(10, 3 * pixel, 3 * pixel + 3);
    given.directRgb.fill(10, 3 * pixel, 3 * pixel + 3);
    expect(before[pixel]).toBeGreaterThan(0.9);
    expect(refinedShares(given, true)[pixel]).toBeLessThan(0.05);
  });

  it("is a number also where everything is black", () => {
    const black = picture(0.1);
    for (const values of [black.directRgb, black.indirectRgb, black.standardErrorRgb]) values.fill(0);
    expect([...refinedShares(black, false)].every((share) => share === 0 || share === 1)).toBe(true);
    black.standardErrorRgb.fill(1e-3);
    expect(refinedShares(black, false).every((share) => share < 0.1)).toBe(true);
  });
});
