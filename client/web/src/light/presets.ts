/** Small procedural maps, for users without their own. */

import { directionOfPixel, type Direction } from "../engine/environment.js";
import type { EnvironmentMap, Rgb } from "../engine/environmentMap.js";

export const presetNames = ["studio", "sky", "sunset", "even"] as const;
export type PresetName = (typeof presetNames)[number];

type Lamp = {
  readonly azimuth: number;
  readonly elevation: number;
  readonly radius: number;
  readonly rgb: Rgb;
};

const lamps: Readonly<Record<PresetName, readonly Lamp[]>> = {
  studio: [
    { azimuth: 40, elevation: 45, radius: 22, rgb: [9, 8.6, 8] },
    { azimuth: -70, elevation: 20, radius: 18, rgb: [3, 3.4, 4] },
    { azimuth: 170, elevation: 60, radius: 14, rgb: [5, 5, 5] },
  ],
  sky: [{ azimuth: 30, elevation: 50, radius: 3, rgb: [900, 840, 740] }],
  sunset: [{ azimuth: -20, elevation: 9, radius: 3, rgb: [620, 300, 110] }],
  even: [],
};

/** Return a map of 512 x 256 pixels. */
export function presetMap(name: PresetName): EnvironmentMap {
  const [height, width] = [256, 512];
  const radianceRgb = new Float32Array(3 * height * width);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const direction = directionOfPixel(row, column, height, width);
      radianceRgb.set(radianceOf(name, direction), 3 * (row * width + column));
    }
  }
  return { height, width, radianceRgb };
}

function radianceOf(name: PresetName, direction: Direction): Rgb {
  const rgb = surroundings(name, direction[2]);
  for (const lamp of lamps[name]) {
    const [azimuth, elevation] = [(lamp.azimuth * Math.PI) / 180, (lamp.elevation * Math.PI) / 180];
    const cosine =
      direction[0] * Math.cos(azimuth) * Math.cos(elevation) +
      direction[1] * Math.sin(azimuth) * Math.cos(elevation) +
      direction[2] * Math.sin(elevation);
    const away = (Math.acos(Math.min(1, cosine)) * 180) / Math.PI;
    // The border is soft over a degree, so that no pixel decides by its centre alone.
    const share = Math.min(Math.max(lamp.radius + 0.5 - away, 0), 1);
    for (const channel of [0, 1, 2] as const) rgb[channel] += share * lamp.rgb[channel];
  }
  return rgb;
}

function surroundings(name: PresetName, z: number): Rgb {
  const mix = (low: Rgb, high: Rgb, share: number): Rgb => [
    low[0] + share * (high[0] - low[0]),
    low[1] + share * (high[1] - low[1]),
    low[2] + share * (high[2] - low[2]),
  ];
  if (name === "even") return [0.8, 0.8, 0.8];
  if (name === "studio") return mix([0.1, 0.1, 0.1], [0.35, 0.35, 0.36], 0.5 + 0.5 * z);
  const ground: Rgb = name === "sky" ? [0.22, 0.2, 0.17] : [0.12, 0.09, 0.08];
  if (z < 0) return mix(ground, ground.map((value) => 1.3 * value) as Rgb, 1 + z);
  const [horizon, zenith]: [Rgb, Rgb] =
    name === "sky"
      ? [
          [0.9, 1.0, 1.15],
          [0.22, 0.42, 0.95],
        ]
      : [
          [1.5, 0.75, 0.4],
          [0.18, 0.24, 0.5],
        ];
  return mix(horizon, zenith, Math.sqrt(z));
}
