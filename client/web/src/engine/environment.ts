/**
 * Environment maps: pixel <-> direction, and turning the light about +z.
 *
 * World right-handed with z up. Row 0 of a map is +z, column W/2 is +x, azimuth falls to the right
 * (docs/reference/conventions.md). Pixel (row, column) has its centre at u = (column + 0.5) / W,
 * v = (row + 0.5) / H with u and v in [0, 1).
 */

/** A unit vector; away from the object, towards the light. */
export type Direction = readonly [x: number, y: number, z: number];

/** Position in a map: u to the right, v downwards, both in [0, 1). */
export type MapPosition = readonly [u: number, v: number];

/** Return the direction that the map position (u, v) stands for. */
export function directionOfUv([u, v]: MapPosition): Direction {
  const azimuth = Math.PI - 2 * Math.PI * u;
  const polar = Math.PI * v;
  const sinPolar = Math.sin(polar);
  return [Math.cos(azimuth) * sinPolar, Math.sin(azimuth) * sinPolar, Math.cos(polar)];
}

/** Return where in the map a unit direction lies; u is 0.5 at the poles. */
export function uvOfDirection([x, y, z]: Direction): MapPosition {
  const turns = 0.5 - Math.atan2(y, x) / (2 * Math.PI);
  return [turns - Math.floor(turns), Math.acos(Math.min(1, Math.max(-1, z))) / Math.PI];
}

/** Return the direction of the centre of pixel (row, column) of a map of height x width pixels. */
export function directionOfPixel(row: number, column: number, height: number, width: number): Direction {
  return directionOfUv([(column + 0.5) / width, (row + 0.5) / height]);
}

/** Return `direction` turned by +degrees about +z (counter-clockwise seen from above). */
export function rotateAboutZ([x, y, z]: Direction, degrees: number): Direction {
  const angle = (degrees * Math.PI) / 180;
  const cos = Math.cos(angle);
  const sin = Math.sin(angle);
  return [cos * x - sin * y, sin * x + cos * y, z];
}
