/** Environment maps looked up in a direction, as shaders do it. */

import { type Direction, uvOfDirection } from "../src/engine/environment.js";
import type { EnvironmentMap, Rgb } from "../src/engine/environmentMap.js";

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
