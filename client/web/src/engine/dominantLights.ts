/**
 * Bright compact peaks of a map as directional lights, the same rule as `lambent_relight.environment.dominant_lights`.
 *
 * Source: docs/reference/conventions.md (dominant lights).
 */

import { dominantMaxTrials, dominantMinShare, dominantRadiusDeg } from "../contract/constants.js";
import { directionOfPixel, type Direction } from "./environment.js";
import { energy, pixelSolidAngle, type EnvironmentMap, type Rgb } from "./environmentMap.js";

/** Light from one direction. */
export type DirectionalLight = {
  readonly direction: Direction;
  /** Irradiance of a surface that faces the light. */
  readonly radianceSolidAngle: Rgb;
};

/** Lights, brightest first, and the map without them. */
export type DominantLights = {
  readonly lights: readonly DirectionalLight[];
  readonly residual: EnvironmentMap;
};

/** Pixels of a map near one of them. */
type Patch = readonly {
  readonly index: number;
  readonly solidAngle: number;
  /** Between a pixel's direction and that of the one in the middle. */
  readonly cosine: number;
}[];

/** Return up to `count` lights of an unturned map and what is left of it. */
export function splitDominantLights(map: EnvironmentMap, count: number): DominantLights {
  const image = new Float32Array(map.radianceRgb);
  const total = sum(energy(map));
  const peaks = new Peaks(map);
  const lights: DirectionalLight[] = [];
  for (let trial = 0; trial < dominantMaxTrials && lights.length < count && total > 0; trial++) {
    const peak = peaks.largest();
    if (peak === null) break;
    const { disk, ring } = diskAndRing(map, peak);
    if (ring.length === 0) break;
    const around = meanOver(image, ring);
    peaks.strike([...disk, ...ring]);
    const light = takeOut(image, map, disk, around, dominantMinShare * total);
    if (light !== null) lights.push(light);
  }
  lights.sort((a, b) => sum(b.radianceSolidAngle) - sum(a.radianceSolidAngle));
  return { lights, residual: { ...map, radianceRgb: image } };
}

/** The pixels that may still be the middle of a light. */
class Peaks {
  readonly #values: Float64Array;
  /** The largest pixel of every row. */
  readonly #ofRow: Uint32Array;
  readonly #width: number;

  constructor({ height, width, radianceRgb }: EnvironmentMap) {
    this.#width = width;
    this.#values = new Float64Array(height * width);
    for (let pixel = 0; pixel < this.#values.length; pixel++) {
      this.#values[pixel] =
        radianceRgb[3 * pixel]! + radianceRgb[3 * pixel + 1]! + radianceRgb[3 * pixel + 2]!;
    }
    this.#ofRow = Uint32Array.from({ length: height }, (_, row) => this.#largestOf(row));
  }

  /** Return the first of the brightest pixels, or null where none is bright. */
  largest(): number | null {
    let best = this.#ofRow[0]!;
    for (const pixel of this.#ofRow) if (this.#values[pixel]! > this.#values[best]!) best = pixel;
    return this.#values[best]! > 0 ? best : null;
  }

  /** Take pixels out of the choice. */
  strike(pixels: Patch): void {
    const rows = new Set<number>();
    for (const { index } of pixels) {
      this.#values[index] = -1;
      rows.add(Math.floor(index / this.#width));
    }
    for (const row of rows) this.#ofRow[row] = this.#largestOf(row);
  }

  #largestOf(row: number): number {
    let best = row * this.#width;
    const end = best + this.#width;
    for (let pixel = best + 1; pixel < end; pixel++) {
      if (this.#values[pixel]! > this.#values[best]!) best = pixel;
    }
    return best;
  }
}

function sum([red, green, blue]: Rgb): number {
  return red + green + blue;
}

function meanOver(image: Float32Array, patch: Patch): Rgb {
  const mean: Rgb = [0, 0, 0];
  let weight = 0;
  for (const { index, solidAngle } of patch) {
    weight += solidAngle;
    for (const channel of [0, 1, 2] as const) mean[channel] += solidAngle * image[3 * index + channel]!;
  }
  return [mean[0] / weight, mean[1] / weight, mean[2] / weight];
}

/** Remove the excess over `around` from the image, unless its energy is below `least`; return the light. */
function takeOut(
  image: Float32Array,
  { height, width }: EnvironmentMap,
  patch: Patch,
  around: Rgb,
  least: number,
): DirectionalLight | null {
  const above = (index: number, channel: 0 | 1 | 2): number =>
    Math.max(image[3 * index + channel]! - around[channel], 0);
  const flux: Rgb = [0, 0, 0];
  for (const { index, solidAngle } of patch) {
    for (const channel of [0, 1, 2] as const) flux[channel] += solidAngle * above(index, channel);
  }
  if (sum(flux) < least) return null;
  const centre: [number, number, number] = [0, 0, 0];
  for (const { index, solidAngle } of patch) {
    const part = above(index, 0) + above(index, 1) + above(index, 2);
    const direction = directionOfPixel(Math.floor(index / width), index % width, height, width);
    for (const axis of [0, 1, 2] as const) centre[axis] += solidAngle * part * direction[axis];
    for (const channel of [0, 1, 2] as const) image[3 * index + channel]! -= above(index, channel);
  }
  const length = Math.hypot(...centre);
  const direction: Direction = [centre[0] / length, centre[1] / length, centre[2] / length];
  return { direction, radianceSolidAngle: flux };
}

/** Return the pixels within 8 degrees of a pixel, and those from there to 12 degrees. */
function diskAndRing(map: EnvironmentMap, peak: number): { disk: Patch; ring: Patch } {
  const [inner, outer] = [
    Math.cos((dominantRadiusDeg * Math.PI) / 180),
    Math.cos((1.5 * dominantRadiusDeg * Math.PI) / 180),
  ];
  const near = around(map, peak, outer);
  const disk = near.filter(({ cosine, index }) => cosine >= inner || index === peak);
  const ring = near.filter(({ cosine, index }) => cosine >= outer && cosine < inner && index !== peak);
  if (ring.length > 0) return { disk, ring };
  // Pixels are larger than the ring: the nearest ones outside take its place.
  const taken = new Set(disk.map(({ index }) => index));
  const outside = around(map, peak, -1).filter(({ index }) => !taken.has(index));
  const nearest = outside.map(({ cosine }) => cosine).sort((a, b) => b - a);
  const least = nearest[Math.min(3, nearest.length - 1)] ?? 0;
  return { disk, ring: outside.filter(({ cosine }) => cosine >= least) };
}

/** Return the pixels near a pixel's row whose directions have about this cosine with its own or more, and itself. */
function around(map: EnvironmentMap, peak: number, least: number): Patch {
  const { height, width } = map;
  const row = Math.floor(peak / width);
  const column = peak % width;
  const centre = directionOfPixel(row, column, height, width);
  const reach = ((1.5 * dominantRadiusDeg) / 180) * height + 1;
  const level = Math.hypot(centre[0], centre[1]);
  const found: Patch[number][] = [];
  for (let r = Math.max(Math.floor(row - reach), 0); r < Math.min(row + reach + 1, height); r++) {
    const solidAngle = pixelSolidAngle(r, height, width);
    const polar = (Math.PI * (r + 0.5)) / height;
    const [along, across] = [centre[2] * Math.cos(polar), level * Math.sin(polar)];
    // Columns further away than this are not near enough in this row.
    const apart = Math.acos(Math.min(Math.max((least - along) / across, -1), 1));
    const away = Math.min(Math.ceil((apart * width) / (2 * Math.PI)), Math.floor(width / 2));
    const end = Math.min(away, width - 1 - away);
    for (let step = -away; step <= end; step++) {
      const c = (column + step + width) % width;
      const [x, y, z] = directionOfPixel(r, c, height, width);
      const cosine = x * centre[0] + y * centre[1] + z * centre[2];
      found.push({ index: r * width + c, solidAngle, cosine });
    }
  }
  return found;
}
