/**
 * A map prepared for the renderer, the same as `lambent_relight.baked.light.prepare_light`: a few dominant
 * lights, harmonics of the rest, and prefiltered levels in one texture.
 */

import { numLevels } from "../contract/constants.js";
import { splitDominantLights, type DirectionalLight } from "../engine/dominantLights.js";
import { directionOfPixel } from "../engine/environment.js";
import { type EnvironmentMap, pixelSolidAngle, resized } from "../engine/environmentMap.js";
import { project } from "../engine/harmonics.js";
import { prefilter } from "../engine/prefilter.js";
import { MapFault } from "../page/fault.js";
import { toHalf } from "../engine/half.js";
import { fillIn, mapFaults } from "../words/words.js";

export const maxDominant = 4;
/** Largest map in memory; larger ones are means of it. */
export const maxWidth = 2048;
/** Harmonics of few bands do not see finer pixels. */
const projectedWidth = 512;

/** Position of a level in the texture: column, row, width, height. */
export type LevelPlace = readonly [x: number, y: number, width: number, height: number];

/** Unrotated light; the renderer rotates it. */
export type PreparedLight = {
  /** Harmonics of the light without `lights`, [bands^2, 3]. */
  readonly coefficientsRgb: Float64Array<ArrayBuffer>;
  /** Harmonics of the whole light, three bands, for plain image-based lighting. */
  readonly plainRgb: Float64Array<ArrayBuffer>;
  readonly bands: number;
  readonly lights: readonly DirectionalLight[];
  /** Radii of even discs that are spread as `lights` are in the map. */
  readonly lightRadiiRad: readonly number[];
  readonly levels: {
    readonly width: number;
    readonly height: number;
    /** Half floats, RGBA. */
    readonly halfRgba: Uint16Array<ArrayBuffer>;
    readonly places: readonly LevelPlace[];
  };
  /** Sentences about changes made to the map. */
  readonly notes: readonly string[];
};

/** A map, and sentences about what was done to it already. */
export type NotedMap = EnvironmentMap & { readonly notes?: readonly string[] };

/** Return a map in the renderer's form; `dominant` lights at most are split off. */
export function prepareLight(given: NotedMap, bands: number, dominant: number): PreparedLight {
  const { map, notes } = usableMap(given);
  const { lights, residual } = splitDominantLights(map, dominant);
  const small = (source: EnvironmentMap): EnvironmentMap =>
    source.width > projectedWidth && source.height > projectedWidth / 2
      ? resized(source, projectedWidth / 2, projectedWidth)
      : source;
  return {
    coefficientsRgb: new Float64Array(project(small(residual), bands)),
    plainRgb: new Float64Array(project(small(map), 3)),
    bands,
    lights,
    lightRadiiRad: lights.map((light) => radiusOf(light, map, residual)),
    levels: packLevels(prefilter(map, numLevels)),
    notes,
  };
}

/** Return the radius of a disc whose mean distance from its centre is that of what was taken out of the map. */
function radiusOf({ direction }: DirectionalLight, map: EnvironmentMap, residual: EnvironmentMap): number {
  const { height, width } = map;
  const within = (9 * Math.PI) / 180;
  const polar = Math.acos(Math.min(Math.max(direction[2], -1), 1));
  const first = Math.max(Math.floor(((polar - within) / Math.PI) * height), 0);
  const last = Math.min(Math.ceil(((polar + within) / Math.PI) * height), height);
  let [flux, away] = [0, 0];
  for (let row = first; row < last; row++) {
    const solidAngle = pixelSolidAngle(row, height, width);
    for (let column = 0; column < width; column++) {
      const start = 3 * (row * width + column);
      let taken = 0;
      for (let channel = 0; channel < 3; channel++) {
        taken += map.radianceRgb[start + channel]! - residual.radianceRgb[start + channel]!;
      }
      if (taken <= 0) continue;
      const other = directionOfPixel(row, column, height, width);
      const cosine = other[0] * direction[0] + other[1] * direction[1] + other[2] * direction[2];
      if (cosine < Math.cos(within)) continue;
      flux += solidAngle * taken;
      away += solidAngle * taken * (1 - cosine);
    }
  }
  // The mean of 1 - cosine over a small disc is a quarter of its radius squared.
  return flux > 0 ? 2 * Math.sqrt(Math.max(away / flux, 0)) : 0;
}

/** Return a map without unusable values and at most as wide as textures, and notes about the changes. */
export function usableMap(given: NotedMap): { map: EnvironmentMap; notes: string[] } {
  const notes = [...(given.notes ?? [])];
  let map = repaired(given, notes);
  if (map.width > maxWidth) {
    const height = Math.max(1, Math.round((map.height * maxWidth) / map.width));
    map = resized(map, height, maxWidth);
    notes.push(
      fillIn(mapFaults.reduced, {
        from: `${given.width} x ${given.height}`,
        to: `${map.width} x ${map.height}`,
      }),
    );
  }
  return { map, notes };
}

/** Replace NaN and negative values by 0 and infinite ones by the largest finite value, and say so. */
export function repaired(map: EnvironmentMap, notes: string[]): EnvironmentMap {
  let largest = 0;
  let count = 0;
  const { radianceRgb: values } = map;
  for (let index = 0; index < values.length; index++) {
    const value = values[index]!;
    if (!(value >= 0) || value === Number.POSITIVE_INFINITY) count++;
    else if (value > largest) largest = value;
  }
  if (count === 0) return map;
  if (count === map.radianceRgb.length) {
    throw new MapFault("environment.no_values", mapFaults.noValues);
  }
  notes.push(fillIn(mapFaults.replaced, { n: count }));
  const radianceRgb = Float32Array.from(map.radianceRgb, (value) => {
    if (!(value >= 0)) return 0;
    return value === Number.POSITIVE_INFINITY ? largest : value;
  });
  return { ...map, radianceRgb };
}

/** Put levels beside each other on shelves of one half-float picture. */
function packLevels(levels: readonly EnvironmentMap[]): PreparedLight["levels"] {
  const width = Math.max(...levels.map((level) => level.width));
  const places: LevelPlace[] = [];
  let [x, y, shelf] = [0, 0, 0];
  for (const level of levels) {
    if (x + level.width > width) [x, y, shelf] = [0, y + shelf, 0];
    places.push([x, y, level.width, level.height]);
    x += level.width;
    shelf = Math.max(shelf, level.height);
  }
  const height = y + shelf;
  const halfRgba = new Uint16Array(4 * width * height);
  levels.forEach((level, index) => {
    const [left, top] = places[index]!;
    for (let row = 0; row < level.height; row++) {
      let source = 3 * row * level.width;
      let target = 4 * ((top + row) * width + left);
      for (let column = 0; column < level.width; column++, source += 3, target += 4) {
        halfRgba[target] = toHalf(level.radianceRgb[source]!);
        halfRgba[target + 1] = toHalf(level.radianceRgb[source + 1]!);
        halfRgba[target + 2] = toHalf(level.radianceRgb[source + 2]!);
      }
    }
  });
  return { width, height, halfRgba, places };
}
