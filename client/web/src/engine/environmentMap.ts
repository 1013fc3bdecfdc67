/** Environment maps as arrays: look-up, solid angles, other programs' layouts, smaller maps. */

import { rotateAboutZ, uvOfDirection, type Direction } from "./environment.js";

/** A latitude-longitude map; row 0 is +z. */
export type EnvironmentMap = {
  readonly height: number;
  readonly width: number;
  /** Linear radiance, three values per pixel, rows from the top. */
  readonly radianceRgb: Float32Array | Float64Array;
};

/** Red, green, blue. */
export type Rgb = [red: number, green: number, blue: number];

/** Layouts of other programs' maps; docs/reference/conventions.md. */
export type MapAxes = "blender" | "threejs" | "mitsuba" | "skylibs";

const quarterTurns: Readonly<Record<MapAxes, number>> = { blender: 0, threejs: 0, mitsuba: -1, skylibs: 1 };

/** Return the angle in degrees by which a map laid out as `axes` must be turned to be ours. */
export function turnOfAxes(axes: MapAxes): number {
  return 90 * quarterTurns[axes];
}

/** Return the solid angle of one pixel of a row, in steradians. */
export function pixelSolidAngle(row: number, height: number, width: number): number {
  const top = Math.cos((Math.PI * row) / height);
  const bottom = Math.cos((Math.PI * (row + 1)) / height);
  return ((2 * Math.PI) / width) * (top - bottom);
}

/** Return the radiance of an unturned map in a direction: bilinear, columns wrap, rows are held at the poles. */
export function lookup(map: EnvironmentMap, direction: Direction): Rgb {
  const [u, v] = uvOfDirection(direction);
  const column = u * map.width - 0.5;
  const row = Math.min(Math.max(v * map.height - 0.5, 0), map.height - 1);
  const floorColumn = Math.floor(column);
  const top = Math.floor(row);
  const across = column - floorColumn;
  const down = row - top;
  const left = (floorColumn + map.width) % map.width;
  const right = (left + 1) % map.width;
  const bottom = Math.min(top + 1, map.height - 1);
  const mix = (channel: number): number => {
    const value = (r: number, c: number): number => map.radianceRgb[3 * (r * map.width + c) + channel]!;
    const upper = value(top, left) * (1 - across) + value(top, right) * across;
    const lower = value(bottom, left) * (1 - across) + value(bottom, right) * across;
    return upper * (1 - down) + lower * down;
  };
  return [mix(0), mix(1), mix(2)];
}

/** Return the radiance in a direction of a map whose light is turned by +rotateDeg about +z. */
export function lookupTurned(map: EnvironmentMap, direction: Direction, rotateDeg: number): Rgb {
  return lookup(map, rotateAboutZ(direction, -rotateDeg));
}

/** Return the integral of radiance over the sphere. */
export function energy(map: EnvironmentMap): Rgb {
  const total: Rgb = [0, 0, 0];
  for (let row = 0; row < map.height; row++) {
    const solidAngle = pixelSolidAngle(row, map.height, map.width);
    for (let column = 0; column < map.width; column++) {
      const start = 3 * (row * map.width + column);
      total[0] += solidAngle * map.radianceRgb[start]!;
      total[1] += solidAngle * map.radianceRgb[start + 1]!;
      total[2] += solidAngle * map.radianceRgb[start + 2]!;
    }
  }
  return total;
}

/**
 * Return the map at another size: the mean over each new pixel, weighted with solid angle, or the interpolant
 * where the map is smaller in a direction.
 */
export function resized(map: EnvironmentMap, height: number, width: number): EnvironmentMap {
  const radianceRgb = new Float64Array(3 * height * width);
  if (map.height < height || map.width < width) {
    interpolate(map, height, width, radianceRgb);
    return { height, width, radianceRgb };
  }
  const line = new Float64Array(3 * map.width);
  for (let row = 0; row < height; row++) {
    meanOfRows(map, row, height, line);
    for (let column = 0; column < width; column++) {
      const from = (column * map.width) / width;
      const to = ((column + 1) * map.width) / width;
      const last = Math.min(Math.ceil(to), map.width);
      let red = 0;
      let green = 0;
      let blue = 0;
      for (let source = Math.floor(from); source < last; source++) {
        const share = ((Math.min(source + 1, to) - Math.max(source, from)) * width) / map.width;
        red += share * line[3 * source]!;
        green += share * line[3 * source + 1]!;
        blue += share * line[3 * source + 2]!;
      }
      const index = 3 * (row * width + column);
      radianceRgb[index] = red;
      radianceRgb[index + 1] = green;
      radianceRgb[index + 2] = blue;
    }
  }
  return { height, width, radianceRgb };
}

/** Write the values of `lookup` at the centres of other pixels. */
function interpolate(map: EnvironmentMap, height: number, width: number, radianceRgb: Float64Array): void {
  const places = Float64Array.from(
    { length: width },
    (_, column) => ((column + 0.5) / width) * map.width - 0.5,
  );
  for (let row = 0; row < height; row++) {
    const place = Math.min(Math.max(((row + 0.5) / height) * map.height - 0.5, 0), map.height - 1);
    const top = Math.floor(place);
    const down = place - top;
    const upper = 3 * top * map.width;
    const lower = 3 * Math.min(top + 1, map.height - 1) * map.width;
    for (let column = 0; column < width; column++) {
      const first = Math.floor(places[column]!);
      const across = places[column]! - first;
      const left = 3 * ((first + map.width) % map.width);
      const right = 3 * ((first + 1) % map.width);
      for (let channel = 0; channel < 3; channel++) {
        const at = (start: number): number => map.radianceRgb[start + channel]!;
        const above = at(upper + left) * (1 - across) + at(upper + right) * across;
        const below = at(lower + left) * (1 - across) + at(lower + right) * across;
        radianceRgb[3 * (row * width + column) + channel] = above * (1 - down) + below * down;
      }
    }
  }
}

/** Write the mean of the source's rows under row `row` of `height` rows. */
function meanOfRows(map: EnvironmentMap, row: number, height: number, line: Float64Array): void {
  const { radianceRgb } = map;
  const top = Math.cos((Math.PI * row) / height);
  const bottom = Math.cos((Math.PI * (row + 1)) / height);
  const last = Math.ceil(((row + 1) * map.height) / height);
  line.fill(0);
  for (let source = Math.floor((row * map.height) / height); source < last; source++) {
    const upper = Math.min(Math.cos((Math.PI * source) / map.height), top);
    const lower = Math.max(Math.cos((Math.PI * (source + 1)) / map.height), bottom);
    const share = (upper - lower) / (top - bottom);
    const start = source * line.length;
    for (let index = 0; index < line.length; index++) {
      line[index] = line[index]! + share * radianceRgb[start + index]!;
    }
  }
}
