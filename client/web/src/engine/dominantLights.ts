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
  const image = new Float64Array(map.radianceRgb);
  const total = sum(energy(map));
  const candidates = new Float64Array(map.height * map.width);
  for (let pixel = 0; pixel < candidates.length; pixel++) {
    candidates[pixel] = image[3 * pixel]! + image[3 * pixel + 1]! + image[3 * pixel + 2]!;
  }
  const lights: DirectionalLight[] = [];
  for (let trial = 0; trial < maxTrials && lights.length < count && total > 0; trial++) {
    const peak = placeOfLargest(candidates);
    if (candidates[peak]! <= 0) break;
    const { disk, ring } = diskAndRing(map, peak);
    if (ring.length === 0) break;
    const around = meanOver(image, ring);
    for (const { index } of [...disk, ...ring]) candidates[index] = -1;
    const light = takeOut(image, disk, around, minShare * total);
    if (light !== null) lights.push(light);
  }
  lights.sort((a, b) => sum(b.radianceSolidAngle) - sum(a.radianceSolidAngle));
  return { lights, residual: { ...map, radianceRgb: new Float32Array(image) } };
}

/** Return the first place of the largest value. */
function placeOfLargest(values: Float64Array): number {
  let best = 0;
  for (let place = 1; place < values.length; place++) if (values[place]! > values[best]!) best = place;
  return best;
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
    for (const axis of [0, 1, 2] as const) centre[axis] = centre[axis]! + together * pixel.direction[axis];
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
  const [inner, outer] = [Math.cos((radiusDeg * Math.PI) / 180), Math.cos((1.5 * radiusDeg * Math.PI) / 180)];
  const disk: Pixel[] = [];
  let ring: Pixel[] = [];
  for (const { pixel, cosine } of around(map, peak, outer)) {
    if (cosine >= inner || pixel.index === peak) disk.push(pixel);
    else if (cosine >= outer) ring.push(pixel);
  }
  if (ring.length === 0) {
    // Pixels are larger than the ring: the nearest ones outside take its place.
    const taken = new Set(disk.map((pixel) => pixel.index));
    const outside = around(map, peak, -1).filter(({ pixel }) => !taken.has(pixel.index));
    const nearest = outside.map(({ cosine }) => cosine).sort((a, b) => b - a);
    const least = nearest[Math.min(3, nearest.length - 1)] ?? 0;
    ring = outside.filter(({ cosine }) => cosine >= least).map(({ pixel }) => pixel);
  }
  return { disk, ring };
}

/** Return the pixels near a pixel's row whose directions have at least this cosine with its own, and itself. */
function around(map: EnvironmentMap, peak: number, least: number): { pixel: Pixel; cosine: number }[] {
  const { height, width } = map;
  const row = Math.floor(peak / width);
  const centre = directionOfPixel(row, peak % width, height, width);
  const reach = ((1.5 * radiusDeg) / 180) * height + 1;
  const level = Math.hypot(centre[0], centre[1]);
  const found: { pixel: Pixel; cosine: number }[] = [];
  for (let r = Math.max(Math.floor(row - reach), 0); r < Math.min(row + reach + 1, height); r++) {
    const solidAngle = pixelSolidAngle(r, height, width);
    const polar = (Math.PI * (r + 0.5)) / height;
    const [along, across] = [centre[2] * Math.cos(polar), level * Math.sin(polar)];
    // The nearest column tells whether any can be near enough.
    if (along + across < least - 1e-9 && r !== row) continue;
    for (let c = 0; c < width; c++) {
      const turned = ((c - (peak % width)) * 2 * Math.PI) / width;
      const index = r * width + c;
      if (least > -1 && along + across * Math.cos(turned) < least - 1e-9 && index !== peak) continue;
      const direction = directionOfPixel(r, c, height, width);
      const cosine = direction[0] * centre[0] + direction[1] * centre[1] + direction[2] * centre[2];
      found.push({ pixel: { index, direction, solidAngle }, cosine });
    }
  }
  return found;
}
