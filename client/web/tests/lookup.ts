/** Environment maps looked up in a direction, as shaders do it. */

import type { Direction } from "../src/engine/environment.js";
import type { EnvironmentMap, Rgb } from "../src/engine/environmentMap.js";

/** Return where in the map a unit direction lies; u is 0.5 at the poles. */
export function uvOfDirection([x, y, z]: Direction): readonly [u: number, v: number] {
  const turns = 0.5 - Math.atan2(y, x) / (2 * Math.PI);
  return [turns - Math.floor(turns), Math.acos(Math.min(1, Math.max(-1, z))) / Math.PI];
}

/** Return `direction` turned by +degrees about +z (counter-clockwise seen from above). */
export function rotateAboutZ([x, y, z]: Direction, degrees: number): Direction {
  const angle = (degrees * Math.PI) / 180;
  const cos = Math.cos(angle);
  const sin = Math.sin(angle);
  return [cos * x - sin * y, sin * x + cos * y, z];
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
