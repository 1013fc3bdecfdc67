/**
 * Environments seen through GGX lobes, the same formula as `lambent_relight.prefilter`.
 *
 * Level k of K has perceptual roughness k / (K - 1); level 0 is the map. Every other level is the mean under
 * w(c) = max(c, 0) / (alpha^2 (1 + c) / 2 + (1 - c) / 2)^2 over the pixels of a source map of its own size.
 * Source: docs/reference/conventions.md (prefiltered levels).
 */

import type { Direction } from "./environment.js";
import { lookupTurned, pixelSolidAngle, resized, type EnvironmentMap, type Rgb } from "./environmentMap.js";
import { EvenFourier, Fourier } from "./fourier.js";

const narrowest = 64;
const widest = 512;
/** Smaller parts of a kernel's transform, relative to its mean, are left out: rows far apart have few waves in common. */
const negligible = 1e-12;

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
      zonalMean(source, (cosine) => {
        const spread = 0.5 * (1 + cosine) * alpha * alpha + 0.5 * (1 - cosine);
        return cosine > 0 ? cosine / (spread * spread) : 0;
      }),
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
 * Return the mean of a map under kernel(cosine) about every pixel; the kernel is zero where the cosine is not
 * positive. The width must be a power of two, the height even.
 *
 * Rows are convolved with each other in azimuth. Kernels are even, so that their transforms are real, and the one
 * of two rows serves four pairs: the rows may change places, and so may north and south.
 */
export function zonalMean(source: EnvironmentMap, kernel: (cosine: number) => number): EnvironmentMap {
  const { height, width } = source;
  const fourier = new Fourier(width);
  const even = new EvenFourier(width / 2);
  const frequencies = width / 2 + 1;
  const stride = 6 * frequencies;
  const spectra = rowSpectra(source, fourier);
  const sums = new Float64Array(height * stride);
  const norms = new Float64Array(height);
  const cosines = Float64Array.from({ length: frequencies }, (_, k) => Math.cos((2 * Math.PI * k) / width));
  const solidAngles = Float64Array.from({ length: height }, (_, row) => pixelSolidAngle(row, height, width));
  const parts = [new Float64Array(frequencies), new Float64Array(frequencies)] as const;
  // Rows between which no cosine is positive have nothing in common.
  const apart = (row: number, other: number): boolean =>
    Math.cos((Math.PI * Math.abs(row - other)) / height) <= 0;
  const add = (to: number, from: number, part: Float64Array, count: number): void => {
    norms[to] = norms[to]! + part[0]! * solidAngles[from]!;
    for (let channel = 0; channel < stride; channel += frequencies) {
      addProducts(sums, stride * to + channel, part, spectra, stride * from + channel, count);
    }
  };
  for (let row = 0; row < height / 2; row++) {
    const mirrored = height - 1 - row;
    const polar = (Math.PI * (row + 0.5)) / height;
    for (let first = row; first <= mirrored && !apart(row, first); first += 2) {
      parts.forEach((part, offset) => {
        const other = (Math.PI * (first + offset + 0.5)) / height;
        const along = Math.cos(polar) * Math.cos(other);
        const across = Math.sin(polar) * Math.sin(other);
        for (let k = 0; k < frequencies; k++) part[k] = kernel(along + across * cosines[k]!);
      });
      even.forward(...parts);
      parts.forEach((part, offset) => {
        const other = first + offset;
        if (other > mirrored || apart(row, other)) return;
        const count = numWaves(part);
        add(row, other, part, count);
        if (other !== row) add(other, row, part, count);
        if (other === mirrored) return;
        add(mirrored, height - 1 - other, part, count);
        if (other !== row) add(height - 1 - other, mirrored, part, count);
      });
    }
  }
  const radianceRgb = new Float64Array(3 * height * width);
  for (let row = 0; row < height; row++) {
    const own = sums.subarray(stride * row, stride * (row + 1));
    writeRow(radianceRgb, own, row, width, norms[row]!, fourier);
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

/** Return how many values of a transform are worth adding. */
function numWaves(transform: Float64Array): number {
  const least = negligible * transform[0]!;
  let count = transform.length;
  while (count > 1 && Math.abs(transform[count - 1]!) < least) count--;
  return count;
}

/** Add the first `count` values of a transform times those of a spectrum to sums. */
function addProducts(
  sums: Float64Array,
  to: number,
  transform: Float64Array,
  spectra: Float64Array,
  from: number,
  count: number,
): void {
  for (let k = 0; k < count; k++) sums[to + k] = sums[to + k]! + transform[k]! * spectra[from + k]!;
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
