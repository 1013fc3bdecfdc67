/**
 * Bright compact peaks of a map as directional lights, the same rule as `lambent_relight.dominant_lights`.
 *
 * Source: docs/reference/conventions.md (dominant lights).
 */

import { directionOfPixel, type Direction } from "./environment.js";
import { energy, pixelSolidAngle, type EnvironmentMap, type Rgb } from "./environmentMap.js";

const radiusDeg = 8;
const minShare = 0.03;
const maxTrials = 16;

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

type Pixel = { readonly index: number; readonly direction: Direction; readonly solidAngle: number };

/** Return up to `count` lights of an unturned map and what is left of it. */
export function splitDominantLights(map: EnvironmentMap, count: number): DominantLights {
  const image = Float64Array.from(map.radianceRgb);
  const total = sum(energy(map));
  const candidates = new Float64Array(map.height * map.width);
  candidates.forEach((_, pixel) => {
    candidates[pixel] = image[3 * pixel]! + image[3 * pixel + 1]! + image[3 * pixel + 2]!;
  });
  const lights: DirectionalLight[] = [];
  for (let trial = 0; trial < maxTrials && lights.length < count && total > 0; trial++) {
    const peak = candidates.reduce((best, value, pixel) => (value > candidates[best]! ? pixel : best), 0);
    if (candidates[peak]! <= 0) break;
    const { disk, ring } = diskAndRing(map, peak);
    if (ring.length === 0) break;
    const around = meanOver(image, ring);
    for (const { index } of [...disk, ...ring]) candidates[index] = -1;
    const light = takeOut(image, disk, around, minShare * total);
    if (light !== null) lights.push(light);
  }
  lights.sort((a, b) => sum(b.radianceSolidAngle) - sum(a.radianceSolidAngle));
  return { lights, residual: { ...map, radianceRgb: Float32Array.from(image) } };
}

function sum([red, green, blue]: Rgb): number {
  return red + green + blue;
}

function meanOver(image: Float64Array, pixels: readonly Pixel[]): Rgb {
  const mean: Rgb = [0, 0, 0];
  let weight = 0;
  for (const { index, solidAngle } of pixels) {
    weight += solidAngle;
    for (const channel of [0, 1, 2] as const) mean[channel] += solidAngle * image[3 * index + channel]!;
  }
  return [mean[0] / weight, mean[1] / weight, mean[2] / weight];
}

/** Take what rises above `around` out of the image, unless its energy is below `least`; return the light. */
function takeOut(
  image: Float64Array,
  disk: readonly Pixel[],
  around: Rgb,
  least: number,
): DirectionalLight | null {
  const above = ({ index }: Pixel, channel: 0 | 1 | 2): number =>
    Math.max(image[3 * index + channel]! - around[channel], 0);
  const flux: Rgb = [0, 0, 0];
  const centre = [0, 0, 0];
  for (const pixel of disk) {
    let together = 0;
    for (const channel of [0, 1, 2] as const) {
      const part = pixel.solidAngle * above(pixel, channel);
      flux[channel] += part;
      together += part;
    }
    pixel.direction.forEach((value, axis) => (centre[axis] = centre[axis]! + together * value));
  }
  if (sum(flux) < least) return null;
  for (const pixel of disk) {
    for (const channel of [0, 1, 2] as const) {
      const slot = 3 * pixel.index + channel;
      image[slot] = image[slot]! - above(pixel, channel);
    }
  }
  const length = Math.hypot(...centre);
  const direction: Direction = [centre[0]! / length, centre[1]! / length, centre[2]! / length];
  return { direction, radianceSolidAngle: flux };
}

/** Return the pixels within 8 degrees of a pixel, and those from there to 12 degrees. */
function diskAndRing(map: EnvironmentMap, peak: number): { disk: Pixel[]; ring: Pixel[] } {
  const { height, width } = map;
  const row = Math.floor(peak / width);
  const centre = directionOfPixel(row, peak % width, height, width);
  const reach = ((1.5 * radiusDeg) / 180) * height + 1;
  const [inner, outer] = [Math.cos((radiusDeg * Math.PI) / 180), Math.cos((1.5 * radiusDeg * Math.PI) / 180)];
  const disk: Pixel[] = [];
  const outside: { readonly pixel: Pixel; readonly cosine: number }[] = [];
  for (let r = Math.max(Math.floor(row - reach), 0); r < Math.min(row + reach + 1, height); r++) {
    const solidAngle = pixelSolidAngle(r, height, width);
    for (let c = 0; c < width; c++) {
      const direction = directionOfPixel(r, c, height, width);
      const cosine = direction[0] * centre[0] + direction[1] * centre[1] + direction[2] * centre[2];
      const pixel = { index: r * width + c, direction, solidAngle };
      if (cosine >= inner || pixel.index === peak) disk.push(pixel);
      else outside.push({ pixel, cosine });
    }
  }
  let ring = outside.filter(({ cosine }) => cosine >= outer);
  if (ring.length === 0 && outside.length > 0) {
    // Pixels are larger than the ring: the nearest ones outside take its place.
    const nearest = outside.map(({ cosine }) => cosine).sort((a, b) => b - a);
    const least = nearest[Math.min(3, nearest.length - 1)]!;
    ring = outside.filter(({ cosine }) => cosine >= least);
  }
  return { disk, ring: ring.map(({ pixel }) => pixel) };
}
