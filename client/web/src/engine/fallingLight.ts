/** Light on an object, and its sums over baked planes: the same as `lambent_relight.baked.light`. */

import type { Direction } from "./environment.js";
import { basis } from "./harmonics.js";

/** Planes of bytes: a value is offset + scale times byte; four planes to a layer. */
type Planes = {
  readonly bands: number;
  readonly layers: number;
  readonly scales: ArrayLike<number>;
  readonly offsets: ArrayLike<number>;
};

/** Rotated and scaled light. */
export type FallingLight = {
  /** Harmonics of the light without the dominant lights, [bands^2, 3]. */
  readonly coefficientsRgb: Float64Array;
  readonly bands: number;
  readonly directions: readonly Direction[];
  /** Of a surface that faces the light. */
  readonly irradianceRgb: readonly (readonly number[])[];
};

/** Return harmonics of all of a light, `bands` of them: dominant lights bounce through their harmonics. */
export function bouncedCoefficients(light: FallingLight, bands: number): Float64Array {
  const coefficientsRgb = light.coefficientsRgb.slice(0, 3 * bands ** 2);
  light.directions.forEach((direction, index) => {
    basis(direction, bands).forEach((value, k) => {
      for (let channel = 0; channel < 3; channel++) {
        coefficientsRgb[3 * k + channel]! += value * light.irradianceRgb[index]![channel]!;
      }
    });
  });
  return coefficientsRgb;
}

/**
 * Return the factors of the planes' bytes, and the constant term. Plane p holds coefficient p / channels of
 * channel p mod channels, or of all three where there is one channel.
 */
export function sumFactors(table: Planes, coefficientsRgb: ArrayLike<number>, channels: 1 | 3) {
  const rgb = [0, 1, 2].map(() => new Float32Array(4 * table.layers));
  const base = [0, 0, 0];
  const count = table.bands ** 2 * channels;
  for (let plane = 0; plane < count; plane++) {
    for (let channel = 0; channel < 3; channel++) {
      if (channels === 3 && plane % 3 !== channel) continue;
      const value = coefficientsRgb[3 * Math.floor(plane / channels) + channel] ?? 0;
      rgb[channel]![plane] = value * table.scales[plane]!;
      base[channel] = base[channel]! + value * table.offsets[plane]!;
    }
  }
  return { red: rgb[0]!, green: rgb[1]!, blue: rgb[2]!, base };
}
