/** Small pictures of lights: a ball that each of them lights. */

import type { Direction } from "../engine/environment.js";
import { type EnvironmentMap, type Rgb, resized } from "../engine/environmentMap.js";
import { basis, cosineFactors, project } from "../engine/harmonics.js";

/** What is lit with fewer pixels than this looks the same at this size. */
const smallWidth = 128;
const albedo = 0.75;
/** Share of a coat that mirrors the light, seen from the front. */
const coat = 0.22;
/** What the mean of the diffuse ball becomes. */
const meanLevel = 0.26;
/** The eye is at +x, a little above, as the viewer's first camera is. */
const eye = { azimuthDeg: 30, elevationDeg: 20 };

/** Return a map of few pixels that lights a ball like the given one. */
export function smallMap(map: EnvironmentMap): EnvironmentMap {
  const isLarge = map.width > smallWidth && map.height > smallWidth / 2;
  return isLarge ? resized(map, smallWidth / 2, smallWidth) : map;
}

/**
 * Return `side` x `side` sRGB-encoded RGBA pixels with straight alpha: a grey ball with a clear coat under a map, as
 * bright as every other one. The map's values are finite and not negative.
 */
export function ballPicture(map: EnvironmentMap, side: number): Uint8ClampedArray<ArrayBuffer> {
  const factors = cosineFactors(3);
  const coefficientsRgb = project(map, 3).map((value, index) => value * factors[Math.floor(index / 3)]!);
  const axes = axesOfEye();
  const linear = new Float32Array(4 * side * side);
  let [sum, count] = [0, 0];
  for (let row = 0; row < side; row++) {
    for (let column = 0; column < side; column++) {
      const [x, y] = [(2 * (column + 0.5)) / side - 1, 1 - (2 * (row + 0.5)) / side];
      const distance = Math.hypot(x, y);
      // The edge is soft over one pixel.
      const alpha = Math.min(Math.max(0.5 * side * (1 - distance), 0), 1);
      if (alpha === 0) continue;
      const z = Math.sqrt(Math.max(1 - distance * distance, 0));
      const inward = distance > 1 ? 1 / distance : 1;
      const normal = axes(x * inward, y * inward, z);
      const mirrored = axes(2 * z * x * inward, 2 * z * y * inward, 2 * z * z - 1);
      const shares = basis(normal, 3);
      const seen = radiance(map, mirrored);
      const mirror = coat + (1 - coat) * (1 - z) ** 5;
      const start = 4 * (row * side + column);
      for (let channel = 0; channel < 3; channel++) {
        let irradiance = 0;
        for (let index = 0; index < 9; index++) {
          irradiance += shares[index]! * coefficientsRgb[3 * index + channel]!;
        }
        const diffuse = (albedo * Math.max(irradiance, 0)) / Math.PI;
        linear[start + channel] = (1 - mirror) * diffuse + mirror * seen[channel]!;
        sum += diffuse;
      }
      linear[start + 3] = alpha;
      count += 3;
    }
  }
  const exposure = sum > 0 ? (meanLevel * count) / sum : 1;
  const pixels = new Uint8ClampedArray(linear.length);
  for (let index = 0; index < linear.length; index++) {
    const isAlpha = index % 4 === 3;
    pixels[index] = 255 * (isAlpha ? linear[index]! : encoded(1 - Math.exp(-exposure * linear[index]!)));
  }
  return pixels;
}

function encoded(value: number): number {
  return value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
}

/** Return what turns a direction of the picture (right, up, towards the eye) into one of the world. */
function axesOfEye(): (right: number, up: number, back: number) => Direction {
  const [azimuth, elevation] = [(eye.azimuthDeg * Math.PI) / 180, (eye.elevationDeg * Math.PI) / 180];
  const [cosA, sinA, cosE, sinE] = [
    Math.cos(azimuth),
    Math.sin(azimuth),
    Math.cos(elevation),
    Math.sin(elevation),
  ];
  return (right, up, back) => [
    -sinA * right - cosA * sinE * up + cosA * cosE * back,
    cosA * right - sinA * sinE * up + sinA * cosE * back,
    cosE * up + sinE * back,
  ];
}

/** Return the bilinear interpolant of a map: columns wrap, rows are held at the poles. */
function radiance({ width, height, radianceRgb }: EnvironmentMap, [x, y, z]: Direction): Rgb {
  const column = (0.5 - Math.atan2(y, x) / (2 * Math.PI)) * width - 0.5;
  const place = (Math.acos(Math.min(Math.max(z, -1), 1)) / Math.PI) * height - 0.5;
  const row = Math.min(Math.max(place, 0), height - 1);
  const [first, top] = [Math.floor(column), Math.floor(row)];
  const [across, down] = [column - first, row - top];
  const [left, right] = [(first + width) % width, (first + 1) % width];
  const bottom = Math.min(top + 1, height - 1);
  const mix = (channel: number): number => {
    const at = (r: number, c: number): number => radianceRgb[3 * (r * width + c) + channel]!;
    const above = at(top, left) * (1 - across) + at(top, right) * across;
    const below = at(bottom, left) * (1 - across) + at(bottom, right) * across;
    return above * (1 - down) + below * down;
  };
  return [mix(0), mix(1), mix(2)];
}
