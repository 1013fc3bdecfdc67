/**
 * Light on level ground: directions of the sky with their radiance, and dominant lights as small discs.
 *
 * The sum over the sky has equal weights pi / count, because directions are spread with density cosine / pi.
 */

import type { Direction } from "../engine/environment.js";
import type { FallingLight } from "../engine/fallingLight.js";
import { basis } from "../engine/harmonics.js";

/** Directions of the sky; a square number of tiles. */
export const numSky = 256;
/** Least height of a direction over the ground, as a sine: shadows of lower light are longer than what is drawn. */
const minSine = 0.02;

/** Irradiance of open ground in parts. */
export type GroundLight = {
  /** Of every direction of the sky, RGBA, alpha zero. */
  readonly skyRgba: Float32Array<ArrayBuffer>;
  /** Of every dominant light, zero for those below the horizon. */
  readonly lightsRgb: readonly (readonly number[])[];
  readonly wholeRgb: readonly [number, number, number];
};

/** Return `count` directions above the ground with density cosine / pi. */
export function skyDirections(count: number): Direction[] {
  return Array.from({ length: count }, (_, index) => {
    const radius = Math.sqrt((index + 0.5) / count);
    const azimuth = index * Math.PI * (3 - Math.sqrt(5));
    return [radius * Math.cos(azimuth), radius * Math.sin(azimuth), Math.sqrt(1 - radius * radius)];
  });
}

/** Return directions spread evenly over the disc of a light, those above the ground only. */
export function discDirections(centre: Direction, radiusRad: number, count: number): Direction[] {
  const [x, y, z] = centre;
  // Any two vectors across the centre do; the branch keeps them away from zero.
  const level = Math.hypot(x, y);
  const first = level > 1e-3 ? [-y / level, x / level, 0] : [1, 0, 0];
  const second = [
    y * first[2]! - z * first[1]!,
    z * first[0]! - x * first[2]!,
    x * first[1]! - y * first[0]!,
  ];
  const found: Direction[] = [];
  for (let index = 0; index < count; index++) {
    const away = Math.tan(radiusRad) * Math.sqrt((index + 0.5) / count);
    const turn = index * Math.PI * (3 - Math.sqrt(5));
    const at = (axis: 0 | 1 | 2): number =>
      centre[axis] + away * (Math.cos(turn) * first[axis]! + Math.sin(turn) * second[axis]!);
    const length = Math.hypot(at(0), at(1), at(2));
    const direction: Direction = [at(0) / length, at(1) / length, at(2) / length];
    if (direction[2] > minSine) found.push(direction);
  }
  return found;
}

const skies = new Map<number, Float64Array>();

/** Return the basis at every direction of the sky, [numSky, bands^2]. */
function skyBasis(bands: number): Float64Array {
  let table = skies.get(bands);
  if (table === undefined) {
    table = Float64Array.from(skyDirections(numSky).flatMap((direction) => [...basis(direction, bands)]));
    skies.set(bands, table);
  }
  return table;
}

/** Return the irradiance of open, level ground; harmonics below zero count as dark. */
export function groundLight(light: FallingLight): GroundLight {
  const { coefficientsRgb, bands, directions, irradianceRgb } = light;
  const table = skyBasis(bands);
  const size = bands * bands;
  const skyRgba = new Float32Array(4 * numSky);
  const wholeRgb: [number, number, number] = [0, 0, 0];
  for (let index = 0; index < numSky; index++) {
    for (const channel of [0, 1, 2] as const) {
      let radiance = 0;
      for (let k = 0; k < size; k++) radiance += table[index * size + k]! * coefficientsRgb[3 * k + channel]!;
      const irradiance = (Math.PI / numSky) * Math.max(radiance, 0);
      skyRgba[4 * index + channel] = irradiance;
      wholeRgb[channel] += irradiance;
    }
  }
  const lightsRgb = directions.map((direction, index) => {
    const cosine = direction[2] > minSine ? direction[2] : 0;
    return irradianceRgb[index]!.map((value, channel) => {
      wholeRgb[channel as 0 | 1 | 2] += cosine * value;
      return cosine * value;
    });
  });
  return { skyRgba, lightsRgb, wholeRgb };
}
