/** Irradiance of every texel under a light: `lambent_relight.baked.light`, on the processor. */

import { numShadowDirections } from "../contract/constants.js";
import {
  type HitTransport,
  type PackedTransport,
  type PlaneTable,
  tableRows,
  tableWidth,
} from "../bundle/transport.js";
import type { Direction } from "../engine/environment.js";
import { bouncedCoefficients, type FallingLight, sumFactors } from "../engine/fallingLight.js";
import { shadowDirections, shadowWeights } from "../engine/shadows.js";

const stored = shadowDirections(numShadowDirections);

/** Return the direct irradiance of every texel, triples, not below zero. */
export function directIrradiance(
  transport: HitTransport,
  normals: Float32Array,
  light: FallingLight,
): Float32Array {
  const { direct, numTexels } = transport;
  const result = planeSums(direct, numTexels, light.coefficientsRgb, 1);
  light.directions.forEach((direction, index) => {
    const irradiance = light.irradianceRgb[index]!;
    const free =
      transport.shadowBits === null ? null : freeShares(transport.shadowBits, numTexels, direction);
    for (let texel = 0; texel < numTexels; texel++) {
      let cosine = 0;
      for (let axis = 0; axis < 3; axis++)
        cosine += normals[3 * texel + axis]! * direction[axis as 0 | 1 | 2];
      if (cosine <= 0) continue;
      const share = free === null ? 1 : free[texel]!;
      for (let channel = 0; channel < 3; channel++) {
        result[3 * texel + channel]! += cosine * share * irradiance[channel]!;
      }
    }
  });
  return result.map((value) => Math.max(value, 0));
}

/** Return the indirect irradiance of every texel, triples, not below zero. */
export function bouncedIrradiance(
  transport: PackedTransport,
  light: FallingLight,
  gain: readonly number[],
): Float32Array {
  const { indirect, coarseOfTexel, numTexels } = transport;
  let numCoarse = 0;
  for (let texel = 0; texel < numTexels; texel++) numCoarse = Math.max(numCoarse, coarseOfTexel[texel]! + 1);
  const coarse = planeSums(indirect, numCoarse, bouncedCoefficients(light, indirect.bands), 3);
  const result = new Float32Array(3 * numTexels);
  for (let texel = 0; texel < numTexels; texel++) {
    for (let channel = 0; channel < 3; channel++) {
      const value = coarse[3 * coarseOfTexel[texel]! + channel]! * gain[channel]!;
      result[3 * texel + channel] = Math.max(value, 0);
    }
  }
  return result;
}

/** Return sums of planes times coefficients, triples; with 3 channels plane 3 k + c is of channel c alone. */
function planeSums(
  table: PlaneTable,
  count: number,
  coefficients: ArrayLike<number>,
  channels: 1 | 3,
): Float32Array {
  const { red, green, blue, base } = sumFactors(table, coefficients, channels);
  const result = Float32Array.from({ length: 3 * count }, (_, index) => base[index % 3]!);
  const layer = 4 * table.rows * tableWidth;
  for (let plane = 0; plane < table.bands ** 2 * channels; plane++) {
    const start = (plane >> 2) * layer + (plane & 3);
    [red, green, blue].forEach((factors, channel) => {
      const factor = factors[plane]!;
      if (factor === 0) return;
      for (let texel = 0; texel < count; texel++) {
        result[3 * texel + channel]! += factor * table.steps[start + 4 * texel]!;
      }
    });
  }
  return result;
}

/** Return the share of a light that reaches every texel: a weighted mean of its nearest shadow bits. */
function freeShares(bits: Uint32Array, numTexels: number, direction: Direction): Float32Array {
  const { indices, weights } = shadowWeights(stored, direction);
  const result = new Float32Array(numTexels);
  const layer = 4 * tableWidth * tableRows(numTexels);
  indices.forEach((bit, index) => {
    const start = (bit >> 7) * layer + ((bit >> 5) & 3);
    for (let texel = 0; texel < numTexels; texel++) {
      result[texel]! += weights[index]! * ((bits[start + 4 * texel]! >>> (bit & 31)) & 1);
    }
  });
  return result;
}
