/** How much of a refined picture is shown in place of the baked one while it is noisy. */

import type { RefinedPicture } from "./accumulation.js";

/** The error that a baked picture is taken to have, as a share of radiance. */
export const bakedError = 0.1;
/** What the denoiser leaves of the noise, about. */
const left = 0.35;
/** Pixels to either side over which noise is taken together: it is itself known from few passes only. */
const reach = 1;
/** Radiance squared below which a share of it says nothing. */
const dark = 1e-8;

/**
 * Return the share of the refined picture in every pixel, 0 where it shows nothing: b^2 / (b^2 + e^2), which is what
 * has the least error if the baked picture is off by b, and the refined one by e, its relative standard error. That is
 * the one around a pixel, or its own where that is larger: a denoiser leaves single bright pixels as they are.
 */
export function refinedShares(
  { width, height, directRgb, indirectRgb, standardErrorRgb, coverage }: RefinedPicture,
  smoothed: boolean,
): Float32Array<ArrayBuffer> {
  const shares = new Float32Array(width * height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const pixel = row * width + column;
      if (coverage[pixel]! <= 0) continue;
      const own = squares(standardErrorRgb, pixel);
      let [variance, radiance, count] = [0, 0, 0];
      for (let i = Math.max(row - reach, 0); i <= Math.min(row + reach, height - 1); i++) {
        for (let j = Math.max(column - reach, 0); j <= Math.min(column + reach, width - 1); j++) {
          const other = i * width + j;
          if (coverage[other]! <= 0) continue;
          count++;
          variance += squares(standardErrorRgb, other);
          for (let at = 3 * other; at < 3 * other + 3; at++) radiance += directRgb[at]! + indirectRgb[at]!;
        }
      }
      // Means over pixels and channels.
      const even = Math.max(variance / count, own) / 3;
      const square = even / Math.max((radiance / (3 * count)) ** 2, dark);
      const noise = square * (smoothed ? left ** 2 : 1);
      shares[pixel] = bakedError ** 2 / (bakedError ** 2 + noise);
    }
  }
  return shares;
}

function squares(rgb: Float32Array, pixel: number): number {
  return rgb[3 * pixel]! ** 2 + rgb[3 * pixel + 1]! ** 2 + rgb[3 * pixel + 2]! ** 2;
}
