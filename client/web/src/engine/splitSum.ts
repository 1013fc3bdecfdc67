/**
 * Specular reflectance under even light, the same sums as `lambent_relight.baked.split_sum`.
 *
 * Reflected radiance under constant unit light is F0 scale + bias. Source: docs/reference/conventions.md
 * (split sum).
 */

import { minAlpha, splitSumAzimuth, splitSumPolar, splitSumSide } from "../contract/constants.js";
import { schlickWeight, shadowing } from "../contract/reflectance.js";

/** The specular reflectance under uniform light is F0 * scale + bias. */
export type SplitSum = { readonly scale: number; readonly bias: number };

const azimuthCosines = Float64Array.from({ length: splitSumAzimuth }, (_, j) =>
  Math.cos((Math.PI * (j + 0.5)) / splitSumAzimuth),
);

/** Return one entry by midpoint sums over half vectors; `cosine` = n.omega_o. */
export function integrate(cosine: number, perceptualRoughness: number): SplitSum {
  const alpha = Math.max(perceptualRoughness * perceptualRoughness, minAlpha);
  const k = 0.5 * alpha;
  const sine = Math.sqrt(1 - cosine * cosine);
  let [scale, bias, shares] = [0, 0, 0];
  for (let i = 0; i < splitSumPolar; i++) {
    const rest = 1 - (i + 0.5) / splitSumPolar;
    const share = rest * rest;
    shares += share;
    const tanSquared = alpha * alpha * (1 / rest ** 3 - 1);
    const cosH = 1 / Math.sqrt(1 + tanSquared);
    const sinH = Math.sqrt(tanSquared) * cosH;
    for (let j = 0; j < splitSumAzimuth; j++) {
      const cosOH = cosine * cosH + sine * sinH * azimuthCosines[j]!;
      const cosI = 2 * cosOH * cosH - cosine;
      if (!(cosI > 0 && cosOH > 0)) continue;
      const weight = (share * shadowing(cosI, alpha) * cosOH) / (cosH * (cosine * (1 - k) + k));
      const fresnel = schlickWeight(Math.min(cosOH, 1));
      scale += weight * (1 - fresnel);
      bias += weight * fresnel;
    }
  }
  return { scale: scale / (shares * splitSumAzimuth), bias: bias / (shares * splitSumAzimuth) };
}

/** Return the table: (scale, bias) of cosine (i / 31)^2 and roughness j / 31 at 2 (32 i + j). */
export function splitSumTable(): Float32Array {
  const table = new Float32Array(2 * splitSumSide * splitSumSide);
  for (let i = 0; i < splitSumSide; i++) {
    for (let j = 0; j < splitSumSide; j++) {
      const { scale, bias } = integrate((i / (splitSumSide - 1)) ** 2, j / (splitSumSide - 1));
      table.set([scale, bias], 2 * (splitSumSide * i + j));
    }
  }
  return table;
}

/** Return the interpolated entry of a table; both arguments are clipped to [0, 1]. */
export function splitSum(table: Float32Array, cosine: number, perceptualRoughness: number): SplitSum {
  const clip = (value: number): number => Math.min(Math.max(value, 0), 1);
  const row = Math.sqrt(clip(cosine)) * (splitSumSide - 1);
  const column = clip(perceptualRoughness) * (splitSumSide - 1);
  const top = Math.min(Math.floor(row), splitSumSide - 2);
  const left = Math.min(Math.floor(column), splitSumSide - 2);
  const mix = (part: 0 | 1): number => {
    const entry = (i: number, j: number): number => table[2 * (splitSumSide * i + j) + part]!;
    const across = column - left;
    const upper = entry(top, left) * (1 - across) + entry(top, left + 1) * across;
    const lower = entry(top + 1, left) * (1 - across) + entry(top + 1, left + 1) * across;
    return upper + (row - top) * (lower - upper);
  };
  return { scale: mix(0), bias: mix(1) };
}
