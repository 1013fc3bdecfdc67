/**
 * Smooths what noise is left in a refined picture: `lambent_relight.refined.denoising`, number for number.
 *
 * Every pixel becomes a mean over those around it, weighted by how alike they are: patches of radiance may differ by
 * as much as their standard errors explain, and albedo, normal and distance by as much as a texture or a curved
 * surface does. For looking, never for measuring. Source: Buades et al. 2005 (non-local means); Rousselle et al. 2012
 * and 2013 (weights from the noise, and features).
 */

import { denoiseLeast, denoisePatch } from "../contract/constants.js";
import type { RefinedPicture } from "./accumulation.js";

/** What stands behind each pixel, rows from the top. */
export type PixelFeatures = {
  /** Linear albedo and world normal, triples. */
  readonly albedo: Float32Array;
  readonly normal: Float32Array;
  /** From the camera, scene units. */
  readonly distance: Float32Array;
};

/** Pixels that take part, to either side. */
const radius = 7;
/** Patches count as alike within this many standard errors of their difference. */
const strength = 0.6;
/** Differences at which a neighbour counts 1/e: of albedo, of normals (a length), and of the distance as a share. */
const widths = { albedo: 0.03, normal: 0.15, distance: 0.02 } as const;
/** Features further apart than this have no part. */
const furthest = 9;
const numFeatures = 7;
/** Messages are let in so often, ms. */
const pauseEveryMs = 40;

/**
 * Return a picture with less noise in its radiance and visibility; its standard errors stay, for the weights are from
 * them. Pixels that the object does not cover stay as they are, and so do the rest once `stopped` says so.
 */
export async function denoised(
  picture: RefinedPicture,
  features: PixelFeatures,
  stopped: () => boolean = () => false,
): Promise<RefinedPicture> {
  const { width, height, directRgb, indirectRgb, visibility, coverage } = picture;
  const rgb = directRgb.map((value, index) => value + indirectRgb[index]!);
  const variance = evenVariance(picture);
  const behind = scaled(features, width * height);
  const out = {
    directRgb: directRgb.slice(),
    indirectRgb: indirectRgb.slice(),
    visibility: visibility.slice(),
  };
  const sums = new Float64Array(numFeatures);
  let pausedAt = performance.now();
  for (let row = 0; row < height && !stopped(); row++) {
    if (performance.now() - pausedAt > pauseEveryMs) {
      await new Promise((resolve) => setTimeout(resolve));
      pausedAt = performance.now();
    }
    for (let column = 0; column < width; column++) {
      const pixel = row * width + column;
      if (coverage[pixel]! <= 0) continue;
      let total = 0;
      sums.fill(0);
      const [top, bottom] = [Math.max(row - radius, 0), Math.min(row + radius + 1, height)];
      const [left, right] = [Math.max(column - radius, 0), Math.min(column + radius + 1, width)];
      for (let i = top; i < bottom; i++) {
        for (let j = left; j < right; j++) {
          const other = i * width + j;
          if (coverage[other]! <= 0) continue;
          let apart = 0;
          for (let k = 0; k < numFeatures; k++) {
            const difference = behind[numFeatures * pixel + k]! - behind[numFeatures * other + k]!;
            apart += difference * difference;
          }
          if (apart > furthest) continue;
          apart += patchDistance(picture, rgb, variance, row, column, i, j);
          const weight = Math.exp(-apart) * coverage[other]!;
          total += weight;
          for (let channel = 0; channel < 3; channel++) {
            sums[channel]! += weight * directRgb[3 * other + channel]!;
            sums[3 + channel]! += weight * indirectRgb[3 * other + channel]!;
          }
          sums[6]! += weight * visibility[other]!;
        }
      }
      for (let channel = 0; channel < 3; channel++) {
        out.directRgb[3 * pixel + channel] = sums[channel]! / total;
        out.indirectRgb[3 * pixel + channel] = sums[3 + channel]! / total;
      }
      out.visibility[pixel] = sums[6]! / total;
    }
  }
  return { ...picture, ...out };
}

/** Return the squared difference of two patches in units of what their noise explains, 0 if it is less. */
function patchDistance(
  { width, height, coverage }: Pick<RefinedPicture, "width" | "height" | "coverage">,
  rgb: Float32Array,
  variance: Float32Array,
  row: number,
  column: number,
  otherRow: number,
  otherColumn: number,
): number {
  let [total, count] = [0, 0];
  for (let i = -denoisePatch; i <= denoisePatch; i++) {
    const [a, c] = [row + i, otherRow + i];
    if (a < 0 || c < 0 || a >= height || c >= height) continue;
    for (let j = -denoisePatch; j <= denoisePatch; j++) {
      const [b, d] = [column + j, otherColumn + j];
      if (b < 0 || d < 0 || b >= width || d >= width) continue;
      const [one, two] = [a * width + b, c * width + d];
      if (coverage[one]! <= 0 || coverage[two]! <= 0) continue;
      for (let k = 0; k < 3; k++) {
        const value = rgb[3 * one + k]!;
        const apart = value - rgb[3 * two + k]!;
        const [own, theirs] = [variance[3 * one + k]!, variance[3 * two + k]!];
        // Noise alone makes the square as large as the sum of both variances.
        const excess = apart * apart - (own + Math.min(own, theirs));
        total += excess / (strength * strength * (own + theirs) + denoiseLeast * value * value + 1e-12);
      }
      count += 3;
    }
  }
  return Math.max(total / Math.max(count, 1), 0);
}

/** Return the variance of every pixel, a mean over 3 x 3 covered ones: an error is itself measured from few passes. */
function evenVariance({ width, height, standardErrorRgb, coverage }: RefinedPicture): Float32Array {
  const even = new Float32Array(3 * width * height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const sums = [0, 0, 0];
      let count = 0;
      for (let i = Math.max(row - 1, 0); i <= Math.min(row + 1, height - 1); i++) {
        for (let j = Math.max(column - 1, 0); j <= Math.min(column + 1, width - 1); j++) {
          const pixel = i * width + j;
          if (coverage[pixel]! <= 0) continue;
          count++;
          for (let k = 0; k < 3; k++) sums[k]! += standardErrorRgb[3 * pixel + k]! ** 2;
        }
      }
      for (let k = 0; k < 3; k++) even[3 * (row * width + column) + k] = sums[k]! / Math.max(count, 1);
    }
  }
  return even;
}

/** Return the features of each pixel in units of their widths. */
function scaled({ albedo, normal, distance }: PixelFeatures, numPixels: number): Float32Array {
  const all = new Float32Array(numFeatures * numPixels);
  for (let pixel = 0; pixel < numPixels; pixel++) {
    const at = numFeatures * pixel;
    for (let k = 0; k < 3; k++) {
      all[at + k] = albedo[3 * pixel + k]! / widths.albedo;
      all[at + 3 + k] = normal[3 * pixel + k]! / widths.normal;
    }
    all[at + 6] = Math.log(Math.max(distance[pixel]!, 1e-12)) / widths.distance;
  }
  return all;
}
