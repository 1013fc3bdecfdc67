/**
 * Primaries that a file states, and the way from its colours to linear Rec. 709, by the rules of
 * `lambent_core.primaries`: the white is adapted to D65 by the Bradford transform.
 */

import { Matrix3, Vector3 } from "three";

const rec709 = [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329];
/** What states that the three channels are X, Y and Z themselves. */
const cieXyz = [1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3];
/** Greatest difference of a coordinate up to which primaries are those of Rec. 709; writers round them. */
const same = 2e-3;
// biome-ignore format: a matrix has rows.
const bradford = new Matrix3(
  0.8951, 0.2664, -0.1614,
  -0.7502, 1.7135, 0.0367,
  0.0389, -0.0685, 1.0296,
);

/**
 * Return the matrix from linear colours of these primaries, CIE x and y of red, green, blue and white, to Rec. 709:
 * null where they are the same, undefined where the numbers are not primaries.
 */
export function rec709Matrix(stated: readonly number[]): Matrix3 | null | undefined {
  if (stated.length !== 8 || !stated.every(Number.isFinite)) return undefined;
  if (stated.every((value, at) => Math.abs(value - rec709[at]!) < same)) return null;
  const ours = xyzFromRgb(rec709)!;
  // Tristimulus values are of no white, so there is none to adapt.
  if (stated.every((value, at) => Math.abs(value - cieXyz[at]!) < same)) return ours.invert();
  const theirs = xyzFromRgb(stated);
  if (theirs === undefined) return undefined;
  const [white, theirWhite] = [ours, theirs].map((matrix) =>
    new Vector3(1, 1, 1).applyMatrix3(matrix).applyMatrix3(bradford),
  ) as [Vector3, Vector3];
  if (theirWhite.toArray().some((value) => Math.abs(value) < 1e-3)) return undefined;
  const adapted = bradford
    .clone()
    .invert()
    .multiply(diagonal(white.divide(theirWhite)))
    .multiply(bradford);
  return ours.invert().multiply(adapted).multiply(theirs);
}

/**
 * Convert colours, three values each, in place. Colours outside Rec. 709 get a negative channel, which becomes 0;
 * where a stored value is negative, infinite or NaN already, all three stay as computed, so that checks find them.
 */
export function toRec709(rgb: Float32Array, matrix: Matrix3 | null): void {
  if (matrix === null) return;
  // Column by column.
  const e = matrix.elements;
  for (let at = 0; at < rgb.length; at += 3) {
    const [red, green, blue] = [rgb[at]!, rgb[at + 1]!, rgb[at + 2]!];
    const sound = red >= 0 && green >= 0 && blue >= 0 && Number.isFinite(red + green + blue);
    for (let channel = 0; channel < 3; channel++) {
      const value = e[channel]! * red + e[3 + channel]! * green + e[6 + channel]! * blue;
      rgb[at + channel] = sound ? Math.max(value, 0) : value;
    }
  }
}

function xyzFromRgb(stated: readonly number[]): Matrix3 | undefined {
  const [r, g, b, white] = [0, 2, 4, 6].map(
    (at) => new Vector3(stated[at], stated[at + 1], 1 - stated[at]! - stated[at + 1]!),
  ) as [Vector3, Vector3, Vector3, Vector3];
  const matrix = new Matrix3(r.x, g.x, b.x, r.y, g.y, b.y, r.z, g.z, b.z);
  if (Math.abs(white.y) < 1e-3 || Math.abs(matrix.determinant()) < 1e-4) return undefined;
  const shares = white.divideScalar(white.y).applyMatrix3(matrix.clone().invert());
  return matrix.multiply(diagonal(shares));
}

function diagonal({ x, y, z }: Vector3): Matrix3 {
  return new Matrix3(x, 0, 0, 0, y, 0, 0, 0, z);
}
