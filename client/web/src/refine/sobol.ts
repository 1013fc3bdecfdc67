/**
 * Even uniforms that the rays of a pixel share: `lambent_relight.refined.pixel_rays`.
 *
 * A pixel has one scrambled Sobol sequence in each pass. Its rays take consecutive elements, each a block of its own,
 * so that the directions of every ray are even, and all of them together are, too. Source: Sobol 1967, with the
 * direction numbers of Joe and Kuo 2008; Owen 1995; Burley 2020, with the constants of Vegdahl 2021 (scrambling).
 */

import type { Randoms } from "./randoms.js";

/** Direction numbers of dimensions 3, 1 and 2, of which the last two become a place in a strategy's square. */
const directions: readonly Uint32Array[] = (() => {
  const [first, second, third] = [new Array<number>(32).fill(1), [1], [1, 3]];
  for (let k = 1; k < 32; k++) second.push(((2 * second[k - 1]!) ^ second[k - 1]!) >>> 0);
  for (let k = 2; k < 32; k++) {
    third.push(((2 * third[k - 1]!) ^ (4 * third[k - 2]!) ^ third[k - 2]!) >>> 0);
  }
  return [third, first, second].map((row) => Uint32Array.from(row, (number, k) => number << (31 - k)));
})();

function reversed(value: number): number {
  let x = value;
  x = ((x & 0x55555555) << 1) | ((x >>> 1) & 0x55555555);
  x = ((x & 0x33333333) << 2) | ((x >>> 2) & 0x33333333);
  x = ((x & 0x0f0f0f0f) << 4) | ((x >>> 4) & 0x0f0f0f0f);
  x = ((x & 0x00ff00ff) << 8) | ((x >>> 8) & 0x00ff00ff);
  return (x << 16) | (x >>> 16);
}

/** Return 32 digits scrambled from the highest down, each by what the higher ones are. */
function scrambled(digits: number, high: number, low: number): number {
  let x = reversed(digits);
  x ^= Math.imul(x, 0x3d20adea);
  x = (x + high) | 0;
  x = Math.imul(x, low | 1);
  x ^= Math.imul(x, 0x05526c56);
  x ^= Math.imul(x, 0x53a22864);
  return reversed(x) >>> 0;
}

/** Pairs of random 32 bits, one for each of three dimensions. */
export type SobolSeeds = Uint32Array;

/** Write the seeds of a sequence. */
export function drawSeeds(randoms: Randoms, out: SobolSeeds): void {
  for (let index = 0; index < 6; index++) out[index] = randoms.nextBits();
}

/** Write `count` consecutive elements of a sequence from number `first` to `out`, triples of uniforms in [0, 1). */
export function sobolElements(seeds: SobolSeeds, first: number, count: number, out: Float64Array): void {
  for (let index = 0; index < count; index++) {
    for (let dimension = 0; dimension < 3; dimension++) {
      let digits = 0;
      const row = directions[dimension]!;
      for (let rest = first + index, bit = 0; rest > 0; rest >>>= 1, bit++) {
        if (rest & 1) digits ^= row[bit]!;
      }
      const [high, low] = [seeds[2 * dimension]!, seeds[2 * dimension + 1]!];
      out[3 * index + dimension] = scrambled(digits, high, low) / 2 ** 32;
    }
  }
}

/** Return for every point how many points of the same pixel come before it. */
export function ranksOf(pixel: Uint32Array): Uint8Array {
  const seen = new Map<number, number>();
  return Uint8Array.from(pixel, (number) => {
    const rank = seen.get(number) ?? 0;
    seen.set(number, rank + 1);
    return rank;
  });
}
