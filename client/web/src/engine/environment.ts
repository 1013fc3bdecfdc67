/**
 * Environment maps: the direction of a pixel.
 *
 * World right-handed with z up. Row 0 of a map is +z, column W/2 is +x, azimuth falls to the right
 * (docs/reference/conventions.md). Pixel (row, column) has its centre at u = (column + 0.5) / W,
 * v = (row + 0.5) / H with u and v in [0, 1).
 */

/** A unit vector; away from the object, towards the light. */
export type Direction = readonly [x: number, y: number, z: number];

/** Return the direction of a position in a map: u to the right, v downwards, both in [0, 1). */
export function directionOfUv([u, v]: readonly [u: number, v: number]): Direction {
  const azimuth = Math.PI - 2 * Math.PI * u;
  const polar = Math.PI * v;
  const sinPolar = Math.sin(polar);
  return [Math.cos(azimuth) * sinPolar, Math.sin(azimuth) * sinPolar, Math.cos(polar)];
}

/** Return the direction of the centre of pixel (row, column) of a map of height x width pixels. */
export function directionOfPixel(row: number, column: number, height: number, width: number): Direction {
  return directionOfUv([(column + 0.5) / width, (row + 0.5) / height]);
}
