/**
 * Environments seen through GGX lobes, the same formula as `lambent_relight.prefilter`.
 *
 * Level k of K has perceptual roughness k / (K - 1); level 0 is the map. Every other level is the mean under
 * w(c) = max(c, 0) / (alpha^2 (1 + c) / 2 + (1 - c) / 2)^2 over the pixels of a source map of its own size.
 * Source: docs/reference/conventions.md (prefiltered levels).
 */

import type { Direction } from "./environment.js";
import { lookupTurned, pixelSolidAngle, resized, type EnvironmentMap, type Rgb } from "./environmentMap.js";
import { Fourier } from "./fourier.js";

const narrowest = 64;
const widest = 512;

/** Levels of an environment, from the sharpest to roughness 1. */
export type Prefiltered = readonly EnvironmentMap[];

/** Return how many columns the level of GGX width alpha > 0 has. */
export function levelWidth(alpha: number): number {
  return Math.min(Math.max(2 ** Math.ceil(Math.log2(16 / alpha)), narrowest), widest);
}

/** Return a map in `numLevels` levels (2 to 16). */
export function prefilter(map: EnvironmentMap, numLevels: number): Prefiltered {
  if (!(numLevels >= 2 && numLevels <= 16)) throw new RangeError(`${numLevels} levels; use 2 to 16`);
  const levels: EnvironmentMap[] = [map];
  const sources = new Map<number, EnvironmentMap>();
  for (let index = 1; index < numLevels; index++) {
    const alpha = (index / (numLevels - 1)) ** 2;
    const width = levelWidth(alpha);
    const source = sources.get(width) ?? resized(map, width / 2, width);
    sources.set(width, source);
    levels.push(
      zonalMean(source, (cosine) => Math.max(cosine, 0) / (0.5 * (1 + cosine) * alpha * alpha + 0.5 * (1 - cosine)) ** 2),
    );
  }
  return levels;
}

/** Return radiance in a direction for a perceptual roughness, of light turned by +rotateDeg about +z. */
export function lookupLevels(
  levels: Prefiltered,
  direction: Direction,
  perceptualRoughness: number,
  rotateDeg = 0,
): Rgb {
  const last = levels.length - 1;
  const place = Math.min(Math.max(perceptualRoughness, 0), 1) * last;
  const index = Math.min(Math.floor(place), last - 1);
  const [low, high] = [levels[index], levels[index + 1]];
  if (low === undefined || high === undefined) throw new RangeError("at least two levels are needed");
  const sharp = lookupTurned(low, direction, rotateDeg);
  const rough = lookupTurned(high, direction, rotateDeg);
  const mix = (channel: 0 | 1 | 2): number =>
    sharp[channel] + (place - index) * (rough[channel] - sharp[channel]);
  return [mix(0), mix(1), mix(2)];
}

/**
 * Return the mean of a map under kernel(cosine) about every pixel. The width must be a power of two, the height
 * even.
 *
 * Rows are convolved with each other in azimuth. Kernels are even, so their transforms are real, and two of them
 * go through one complex transform. A row and its mirror image use the same kernels.
 */
export function zonalMean(source: EnvironmentMap, kernel: (cosine: number) => number): EnvironmentMap {
  const { height, width } = source;
  const fourier = new Fourier(width);
  const frequencies = width / 2 + 1;
  const spectra = rowSpectra(source, fourier);
  const radianceRgb = new Float64Array(3 * height * width);
  const cosines = Float64Array.from({ length: frequencies }, (_, k) => Math.cos((2 * Math.PI * k) / width));
  const parts = [new Float64Array(width), new Float64Array(width)] as const;
  for (let row = 0; row < height / 2; row++) {
    const sums = new Float64Array(6 * frequencies);
    const mirroredSums = new Float64Array(6 * frequencies);
    const polar = (Math.PI * (row + 0.5)) / height;
    let norm = 0;
    for (let first = 0; first < height; first += 2) {
      parts.forEach((part, offset) => {
        const other = (Math.PI * (first + offset + 0.5)) / height;
        const along = Math.cos(polar) * Math.cos(other);
        const across = Math.sin(polar) * Math.sin(other);
        for (let k = 0; k < frequencies; k++) part[k] = kernel(along + across * cosines[k]!);
        for (let k = 1; k < frequencies - 1; k++) part[width - k] = part[k]!;
      });
      fourier.forward(...parts);
      parts.forEach((part, offset) => {
        const other = first + offset;
        norm += part[0]! * pixelSolidAngle(other, height, width);
        addProducts(sums, part, spectra, 6 * frequencies * other, frequencies);
        addProducts(mirroredSums, part, spectra, 6 * frequencies * (height - 1 - other), frequencies);
      });
    }
    writeRow(radianceRgb, sums, row, width, norm, fourier);
    writeRow(radianceRgb, mirroredSums, height - 1 - row, width, norm, fourier);
  }
  return { height, width, radianceRgb };
}

/** Return the transforms of rows times solid angle: per row and channel first the real, then imaginary parts. */
function rowSpectra(source: EnvironmentMap, fourier: Fourier): Float64Array {
  const { height, width, radianceRgb } = source;
  const frequencies = width / 2 + 1;
  const spectra = new Float64Array(6 * frequencies * height);
  for (let row = 0; row < height; row++) {
    const solidAngle = pixelSolidAngle(row, height, width);
    for (let channel = 0; channel < 3; channel++) {
      const real = new Float64Array(width);
      const imaginary = new Float64Array(width);
      for (let column = 0; column < width; column++) {
        real[column] = solidAngle * radianceRgb[3 * (row * width + column) + channel]!;
      }
      fourier.forward(real, imaginary);
      const start = (3 * row + channel) * 2 * frequencies;
      spectra.set(real.subarray(0, frequencies), start);
      spectra.set(imaginary.subarray(0, frequencies), start + frequencies);
    }
  }
  return spectra;
}

/** Add a kernel's real transform times the spectra of one row, which start at `from`, to `sums`. */
function addProducts(
  sums: Float64Array,
  kernel: Float64Array,
  spectra: Float64Array,
  from: number,
  frequencies: number,
): void {
  for (let part = 0; part < 6 * frequencies; part += frequencies) {
    for (let k = 0; k < frequencies; k++) sums[part + k]! += kernel[k]! * spectra[from + part + k]!;
  }
}

/** Transform three channels back and write them, over `norm`, as one row of the result. */
function writeRow(
  radianceRgb: Float64Array,
  sums: Float64Array,
  row: number,
  width: number,
  norm: number,
  fourier: Fourier,
): void {
  const frequencies = width / 2 + 1;
  for (let channel = 0; channel < 3; channel++) {
    const start = channel * 2 * frequencies;
    const real = new Float64Array(width);
    const imaginary = new Float64Array(width);
    for (let k = 0; k < frequencies; k++) {
      real[k] = sums[start + k]!;
      // The forward transform of the conjugate is the conjugate of the inverse one, and the row is real.
      imaginary[k] = -sums[start + frequencies + k]!;
      if (k > 0 && k < frequencies - 1) {
        real[width - k] = real[k]!;
        imaginary[width - k] = -imaginary[k]!;
      }
    }
    fourier.forward(real, imaginary);
    for (let column = 0; column < width; column++) {
      radianceRgb[3 * (row * width + column) + channel] = Math.max(real[column]! / (width * norm), 0);
    }
  }
}
