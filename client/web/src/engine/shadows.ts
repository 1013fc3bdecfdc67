/**
 * The stored directions that determine a light's visibility: the same rule as `lambent_relight.baked.light`.
 */

import type { Direction } from "./environment.js";

const numNeighbours = 6;

/** Stored directions and their weights, which sum to one. */
export type ShadowWeights = { readonly indices: readonly number[]; readonly weights: readonly number[] };

/** Return even unit directions: z = 1 - (2 j + 1) / count, azimuth j pi (3 - sqrt 5). */
export function shadowDirections(count: number): Direction[] {
  return Array.from({ length: count }, (_, j) => {
    const z = 1 - (2 * j + 1) / count;
    const azimuth = j * Math.PI * (3 - Math.sqrt(5));
    const radius = Math.sqrt(1 - z * z);
    return [radius * Math.cos(azimuth), radius * Math.sin(azimuth), z];
  });
}

/** Return the six stored directions nearest to a unit direction, with weights; the last one's is zero. */
export function shadowWeights(stored: readonly Direction[], direction: Direction): ShadowWeights {
  const indices: number[] = [];
  const cosines: number[] = [];
  stored.forEach((other, index) => {
    const cosine = other[0] * direction[0] + other[1] * direction[1] + other[2] * direction[2];
    let place = cosines.length;
    while (place > 0 && cosines[place - 1]! < cosine) place--;
    if (place >= numNeighbours) return;
    cosines.splice(place, 0, cosine);
    indices.splice(place, 0, index);
    cosines.length = Math.min(cosines.length, numNeighbours);
    indices.length = cosines.length;
  });
  const raw = cosines.map((cosine) => Math.exp((stored.length / 4) * (cosine - cosines[0]!)));
  const above = raw.map((weight) => weight - raw.at(-1)!);
  const sum = above.reduce((total, weight) => total + weight, 0);
  return { indices, weights: above.map((weight) => (sum > 0 ? weight / sum : 1 / numNeighbours)) };
}
