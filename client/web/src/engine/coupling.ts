/**
 * The coupling of a map's rows by the kernel of a GGX lobe: transforms of its values over the columns.
 *
 * The kernel is w(c) = max(c, 0) / (alpha^2 (1 + c) / 2 + (1 - c) / 2)^2 of the cosine c between two pixels, and
 * c = cos(polar) cos(other) + sin(polar) sin(other) cos(azimuth): even in azimuth, so that transforms are real.
 */

import { EvenFourier } from "./fourier.js";

/** Smaller parts of a transform, relative to its mean, are left out: rows far apart have few waves in common. */
const negligible = 1e-10;
/** Columns that are enough for what lies below the horizon. */
const fewColumns = 64;

/**
 * Writes the transforms between the row at a polar angle and those at `other` (`near`) and at pi - `other` (`far`),
 * width / 2 + 1 values each; returns how many of them are worth adding.
 */
export type Coupling = (polar: number, other: number, near: Float64Array, far: Float64Array) => number;

/** Return the coupling by sums over `width` columns, a power of two. */
export function sampledCoupling(alpha: number, width: number): Coupling {
  const even = new EvenFourier(width / 2);
  const cosines = azimuthCosines(width);
  const kernel = (cosine: number): number => (cosine > 0 ? lobe(cosine, alpha) : 0);
  return (polar, other, near, far) => {
    const along = Math.cos(polar) * Math.cos(other);
    const across = Math.sin(polar) * Math.sin(other);
    for (let k = 0; k < cosines.length; k++) {
      near[k] = kernel(along + across * cosines[k]!);
      far[k] = kernel(-along + across * cosines[k]!);
    }
    even.forward(near, far);
    return Math.max(numWaves(near), numWaves(far));
  };
}

/**
 * Return the coupling of a narrow lobe, `alpha` well below 1, from a formula.
 *
 * Without its cut at the horizon the kernel is (c / (A - B cos azimuth)^2), with c linear in cos azimuth. Its Fourier
 * coefficients are (u + v m) r^m, r = B / (A + D), D^2 = A^2 - B^2; the sum over `width` columns folds those of
 * m, width - m, width + m ... into one. What the cut takes away is smooth, and summed over few columns.
 */
export function narrowCoupling(alpha: number, width: number): Coupling {
  const few = new EvenFourier(fewColumns / 2);
  const cosines = azimuthCosines(fewColumns);
  const [cutNear, cutFar] = [new Float64Array(cosines.length), new Float64Array(cosines.length)];
  const below = (cosine: number): number => (cosine < 0 ? lobe(cosine, alpha) : 0);
  return (polar, other, near, far) => {
    const along = Math.cos(polar) * Math.cos(other);
    const across = Math.sin(polar) * Math.sin(other);
    const nearCount = lobeWaves(alpha, along, across, width, near);
    const farCount = lobeWaves(alpha, -along, across, width, far);
    for (let k = 0; k < cosines.length; k++) {
      cutNear[k] = below(along + across * cosines[k]!);
      cutFar[k] = below(-along + across * cosines[k]!);
    }
    few.forward(cutNear, cutFar);
    for (let k = 0; k < cosines.length; k++) {
      near[k] = near[k]! - (width / fewColumns) * cutNear[k]!;
      far[k] = far[k]! - (width / fewColumns) * cutFar[k]!;
    }
    return Math.max(nearCount, farCount, cosines.length);
  };
}

/** Write the transform of the kernel without its cut; returns how many values are worth adding, zeros follow. */
function lobeWaves(alpha: number, along: number, across: number, width: number, into: Float64Array): number {
  const a = 0.5 + 0.5 * alpha * alpha;
  const b = 0.5 - 0.5 * alpha * alpha;
  const A = a - b * along;
  const B = b * across;
  const D = Math.sqrt((A - B) * (A + B));
  const u = (width * ((a * A) / (D * D) - 1)) / (b * D);
  const v = (width * a) / (b * D * D);
  const r = B / (A + D);
  // Sums over m = k, k + width, k + 2 width ..., and over m = width - k, 2 width - k ...
  const round = r ** width;
  const once = 1 / (1 - round);
  const more = v * width * once * once;
  let power = 1;
  let inverse = round;
  let count = 0;
  for (; count < into.length; count++) {
    const rising = power * ((u + v * count) * once + round * more);
    const value = rising + inverse * ((u - v * count) * once + more);
    if (count > 0 && Math.abs(value) < negligible * into[0]!) break;
    into[count] = value;
    power *= r;
    inverse /= r;
  }
  into.fill(0, count);
  return count;
}

function lobe(cosine: number, alpha: number): number {
  const spread = 0.5 * (1 + cosine) * alpha * alpha + 0.5 * (1 - cosine);
  return cosine / (spread * spread);
}

function azimuthCosines(width: number): Float64Array {
  return Float64Array.from({ length: width / 2 + 1 }, (_, k) => Math.cos((2 * Math.PI * k) / width));
}

/** Return the number of significant values of a transform. */
function numWaves(transform: Float64Array): number {
  const least = negligible * Math.abs(transform[0]!);
  let count = transform.length;
  while (count > 1 && Math.abs(transform[count - 1]!) <= least) count--;
  return count;
}
