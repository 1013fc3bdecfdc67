/** Small procedural maps, for users without their own. */

import { directionOfPixel, type Direction } from "../engine/environment.js";
import type { EnvironmentMap, Rgb } from "../engine/environmentMap.js";

/** Names of the maps, in the order in which they are offered. */
export const presetNames = ["softboxes", "studio", "sky", "sunset", "even"] as const;
export type PresetName = (typeof presetNames)[number];

type Lamp = {
  readonly azimuth: number;
  readonly elevation: number;
  readonly radius: number;
  readonly rgb: Rgb;
};

/** A rectangle, upright and facing the middle; angles in degrees. */
type Panel = Omit<Lamp, "radius"> & { readonly width: number; readonly height: number };

/** The softboxes stand for someone who looks from +x: the key light left, a strip right, one above, one behind. */
const panels: readonly Panel[] = [
  { azimuth: -52, elevation: 36, width: 46, height: 38, rgb: [10, 9.6, 9] },
  { azimuth: 72, elevation: 20, width: 18, height: 62, rgb: [3.4, 3.7, 4.2] },
  { azimuth: 165, elevation: 38, width: 40, height: 26, rgb: [9, 9, 9] },
  { azimuth: 0, elevation: 82, width: 50, height: 26, rgb: [3, 3, 3] },
];

const lamps: Readonly<Record<PresetName, readonly Lamp[]>> = {
  softboxes: [],
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
  if (name === "softboxes") {
    for (const panel of panels) {
      const share = shareOf(panel, direction);
      for (const channel of [0, 1, 2] as const) rgb[channel] += share * panel.rgb[channel];
    }
  }
  return rgb;
}

/** Return how much of a panel is seen in a direction: 1 inside, and less towards its border. */
function shareOf({ azimuth, elevation, width, height }: Panel, [x, y, z]: Direction): number {
  const radians = Math.PI / 180;
  const [ca, sa] = [Math.cos(azimuth * radians), Math.sin(azimuth * radians)];
  const [ce, se] = [Math.cos(elevation * radians), Math.sin(elevation * radians)];
  const ahead = x * ca * ce + y * sa * ce + z * se;
  if (ahead <= 0) return 0;
  const across = Math.abs(y * ca - x * sa) / ahead;
  const along = Math.abs(z * ce - (x * ca + y * sa) * se) / ahead;
  const inside = (slope: number, size: number): number => {
    const most = Math.tan(0.5 * size * radians);
    return Math.min(Math.max((most - slope) / (0.25 * most), 0), 1);
  };
  const share = inside(across, width) * inside(along, height);
  return share * share * (3 - 2 * share);
}

function surroundings(name: PresetName, z: number): Rgb {
  const mix = (low: Rgb, high: Rgb, share: number): Rgb => [
    low[0] + share * (high[0] - low[0]),
    low[1] + share * (high[1] - low[1]),
    low[2] + share * (high[2] - low[2]),
  ];
  if (name === "even") return [0.8, 0.8, 0.8];
  if (name === "softboxes") {
    const horizon: Rgb = [0.42, 0.42, 0.43];
    return z < 0 ? mix(horizon, [0.3, 0.29, 0.28], -z) : mix(horizon, [0.1, 0.1, 0.11], Math.sqrt(z));
  }
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
