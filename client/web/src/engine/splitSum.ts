/**
 * Specular reflectance under even light, the same sums as `lambent_relight.baked.split_sum`.
 *
 * Reflected radiance under constant unit light is F0 scale + bias. Source: docs/reference/conventions.md
 * (split sum).
 */

/** Entries of the table along the cosine's root and along perceptual roughness. */
export const tableSide = 32;
const minAlpha = 1e-4;
const numPolar = 64;
const numAzimuth = 32;

/** The specular reflectance under uniform light is F0 * scale + bias. */
export type SplitSum = { readonly scale: number; readonly bias: number };

const azimuthCosines = Float64Array.from({ length: numAzimuth }, (_, j) =>
  Math.cos((Math.PI * (j + 0.5)) / numAzimuth),
);

/** Return one entry by midpoint sums over half vectors; `cosine` = n.omega_o. */
export function integrate(cosine: number, perceptualRoughness: number): SplitSum {
  const alpha = Math.max(perceptualRoughness * perceptualRoughness, minAlpha);
  const k = 0.5 * alpha;
  const sine = Math.sqrt(1 - cosine * cosine);
  let [scale, bias, shares] = [0, 0, 0];
  for (let i = 0; i < numPolar; i++) {
    const rest = 1 - (i + 0.5) / numPolar;
    const share = rest * rest;
    shares += share;
    const tanSquared = alpha * alpha * (1 / rest ** 3 - 1);
    const cosH = 1 / Math.sqrt(1 + tanSquared);
    const sinH = Math.sqrt(tanSquared) * cosH;
    for (let j = 0; j < numAzimuth; j++) {
      const cosOH = cosine * cosH + sine * sinH * azimuthCosines[j]!;
      const cosI = 2 * cosOH * cosH - cosine;
      if (!(cosI > 0 && cosOH > 0)) continue;
      const shadowing = cosI / (cosI * (1 - k) + k);
      const weight = (share * shadowing * cosOH) / (cosH * (cosine * (1 - k) + k));
      const glancing = 1 - Math.min(cosOH, 1);
      const squared = glancing * glancing;
      const fresnel = squared * squared * glancing;
      scale += weight * (1 - fresnel);
      bias += weight * fresnel;
    }
  }
  return { scale: scale / (shares * numAzimuth), bias: bias / (shares * numAzimuth) };
}

/** Return the table: (scale, bias) of cosine (i / 31)^2 and roughness j / 31 at 2 (32 i + j). */
export function splitSumTable(): Float32Array {
  const table = new Float32Array(2 * tableSide * tableSide);
  for (let i = 0; i < tableSide; i++) {
    for (let j = 0; j < tableSide; j++) {
      const { scale, bias } = integrate((i / (tableSide - 1)) ** 2, j / (tableSide - 1));
      table.set([scale, bias], 2 * (tableSide * i + j));
    }
  }
  return table;
}

/** Return the interpolated entry of a table; both arguments are clipped to [0, 1]. */
export function splitSum(table: Float32Array, cosine: number, perceptualRoughness: number): SplitSum {
  const clip = (value: number): number => Math.min(Math.max(value, 0), 1);
  const row = Math.sqrt(clip(cosine)) * (tableSide - 1);
  const column = clip(perceptualRoughness) * (tableSide - 1);
  const top = Math.min(Math.floor(row), tableSide - 2);
  const left = Math.min(Math.floor(column), tableSide - 2);
  const mix = (part: 0 | 1): number => {
    const entry = (i: number, j: number): number => table[2 * (tableSide * i + j) + part]!;
    const across = column - left;
    const upper = entry(top, left) * (1 - across) + entry(top, left + 1) * across;
    const lower = entry(top + 1, left) * (1 - across) + entry(top + 1, left + 1) * across;
    return upper + (row - top) * (lower - upper);
  };
  return { scale: mix(0), bias: mix(1) };
}
