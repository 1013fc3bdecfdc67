/**
 * Environments seen through GGX lobes, the same formula as `lambent_relight.environment.prefilter`.
 *
 * Level k of K has perceptual roughness k / (K - 1); level 0 is the map. Every other level is the mean under
 * w(c) = max(c, 0) / (alpha^2 (1 + c) / 2 + (1 - c) / 2)^2 over the pixels of a source map of its own size.
 * Source: docs/reference/conventions.md (prefiltered levels).
 */

import { narrowestLevel, widestLevel } from "../contract/constants.js";
import { pixelSolidAngle, resized, type EnvironmentMap } from "./environmentMap.js";
import { type Coupling, narrowCoupling, sampledCoupling } from "./coupling.js";
import { Fourier } from "./fourier.js";

/** Levels of an environment, from the sharpest to roughness 1. */
export type Prefiltered = readonly EnvironmentMap[];

/** Return the number of columns of the level of GGX width alpha > 0. */
export function levelWidth(alpha: number): number {
  return Math.min(Math.max(2 ** Math.ceil(Math.log2(16 / alpha)), narrowestLevel), widestLevel);
}

/** Return a map in `numLevels` levels (2 to 16). */
export function prefilter(map: EnvironmentMap, numLevels: number): Prefiltered {
  if (!(numLevels >= 2 && numLevels <= 16)) throw new RangeError(`${numLevels} levels; use 2 to 16`);
  const levels: EnvironmentMap[] = [map];
  let source: EnvironmentMap | null = null;
  for (let index = 1; index < numLevels; index++) {
    const alpha = (index / (numLevels - 1)) ** 2;
    const width = levelWidth(alpha);
    if (source?.width !== width) {
      // Means of means are means; what was interpolated is not.
      const fine: boolean = source !== null && source.width <= map.width && source.height <= map.height;
      source = resized(fine ? source! : map, width / 2, width);
    }
    levels.push(
      zonalMean(source, width < widestLevel ? sampledCoupling(alpha, width) : narrowCoupling(alpha, width)),
    );
  }
  return levels;
}

/**
 * Return the mean of a map about every pixel under the kernel of a coupling. The width must be a power of two, the
 * height even.
 *
 * Rows are convolved with each other in azimuth. The kernel does not see whether a pair of rows is mirrored at the
 * equator, so that sums and differences of mirrored rows are convolved apart, with half the work.
 */
export function zonalMean(source: EnvironmentMap, coupling: Coupling): EnvironmentMap {
  const { height, width } = source;
  const half = height / 2;
  const frequencies = width / 2 + 1;
  const stride = 6 * frequencies;
  const fourier = new Fourier(width);
  const [folded, sums] = [new Float64Array(2 * stride * half), new Float64Array(2 * stride * half)];
  const norms = new Float64Array(half);
  const solidAngles = Float64Array.from({ length: half }, (_, row) => pixelSolidAngle(row, height, width));
  const polars = Float64Array.from({ length: half }, (_, row) => (Math.PI * (row + 0.5)) / height);
  for (let row = 0; row < half; row++) foldRows(source, row, solidAngles[row]!, fourier, folded);
  const [near, far] = [new Float64Array(frequencies), new Float64Array(frequencies)];
  const add = (to: number, from: number, count: number): void => {
    norms[to] = norms[to]! + near[0]! * solidAngles[from]!;
    addProducts(sums, 2 * stride * to, near, folded, 2 * stride * from, count);
    addProducts(sums, 2 * stride * to + stride, far, folded, 2 * stride * from + stride, count);
  };
  for (let row = 0; row < half; row++) {
    for (let other = row; other < half; other++) {
      const count = coupling(polars[row]!, polars[other]!, near, far);
      for (let k = 0; k < count; k++) {
        const straight = near[k]!;
        near[k] = straight + far[k]!;
        far[k] = straight - far[k]!;
      }
      add(row, other, count);
      if (other !== row) add(other, row, count);
    }
  }
  const radianceRgb = new Float64Array(3 * height * width);
  const result = { height, width, radianceRgb };
  for (let row = 0; row < half; row++) unfoldRows(sums, row, width * norms[row]!, fourier, result);
  return result;
}

/**
 * Write the transforms of a row plus and minus its mirrored one, times solid angle, to `folded`: row by row first the
 * sum, then the difference, frequency by frequency (real, imaginary) of red, green, blue.
 */
function foldRows(
  { height, width, radianceRgb }: EnvironmentMap,
  row: number,
  solidAngle: number,
  fourier: Fourier,
  folded: Float64Array,
): void {
  const stride = 3 * (width + 2);
  const [real, imaginary] = [new Float64Array(width), new Float64Array(width)];
  const [upper, lower] = [3 * row * width, 3 * (height - 1 - row) * width];
  for (let channel = 0; channel < 3; channel++) {
    for (let column = 0; column < width; column++) {
      const above = solidAngle * radianceRgb[upper + 3 * column + channel]!;
      const below = solidAngle * radianceRgb[lower + 3 * column + channel]!;
      real[column] = above + below;
      imaginary[column] = above - below;
    }
    // Two real rows go through one complex transform.
    fourier.forward(real, imaginary);
    for (let k = 0; k <= width / 2; k++) {
      const mirrored = (width - k) % width;
      const at = 2 * stride * row + 6 * k + 2 * channel;
      folded[at] = 0.5 * (real[k]! + real[mirrored]!);
      folded[at + 1] = 0.5 * (imaginary[k]! - imaginary[mirrored]!);
      folded[at + stride] = 0.5 * (imaginary[k]! + imaginary[mirrored]!);
      folded[at + stride + 1] = 0.5 * (real[mirrored]! - real[k]!);
    }
  }
}

/** Add the first `count` values of a transform times those of three channels to sums. */
function addProducts(
  sums: Float64Array,
  to: number,
  transform: Float64Array,
  folded: Float64Array,
  from: number,
  count: number,
): void {
  for (let k = 0; k < count; k++) {
    const factor = transform[k]!;
    const target = to + 6 * k;
    const source = from + 6 * k;
    sums[target] = sums[target]! + factor * folded[source]!;
    sums[target + 1] = sums[target + 1]! + factor * folded[source + 1]!;
    sums[target + 2] = sums[target + 2]! + factor * folded[source + 2]!;
    sums[target + 3] = sums[target + 3]! + factor * folded[source + 3]!;
    sums[target + 4] = sums[target + 4]! + factor * folded[source + 4]!;
    sums[target + 5] = sums[target + 5]! + factor * folded[source + 5]!;
  }
}

/** Transform a row's sum and difference back, and write them, over `norm`, as the row and its mirrored one. */
function unfoldRows(
  sums: Float64Array,
  row: number,
  norm: number,
  fourier: Fourier,
  { height, width, radianceRgb }: EnvironmentMap,
): void {
  const stride = 3 * (width + 2);
  const [real, imaginary] = [new Float64Array(width), new Float64Array(width)];
  const [upper, lower] = [3 * row * width, 3 * (height - 1 - row) * width];
  for (let channel = 0; channel < 3; channel++) {
    for (let k = 0; k <= width / 2; k++) {
      const mirrored = (width - k) % width;
      const at = 2 * stride * row + 6 * k + 2 * channel;
      const odd = at + stride;
      // The forward transform of the conjugate is the conjugate of the inverse one.
      real[mirrored] = sums[at]! + sums[odd + 1]!;
      imaginary[mirrored] = sums[at + 1]! - sums[odd]!;
      real[k] = sums[at]! - sums[odd + 1]!;
      imaginary[k] = -sums[at + 1]! - sums[odd]!;
    }
    fourier.forward(real, imaginary);
    for (let column = 0; column < width; column++) {
      const even = real[column]! / (2 * norm);
      const odd = -imaginary[column]! / (2 * norm);
      radianceRgb[upper + 3 * column + channel] = Math.max(even + odd, 0);
      radianceRgb[lower + 3 * column + channel] = Math.max(even - odd, 0);
    }
  }
}
