/**
 * Primaries that a file states, and the way from its colours to linear Rec. 709, by the rules of
 * `lambent_core.primaries`: the white is adapted to D65 by the Bradford transform.
 */

/** Three rows of three numbers. */
export type Matrix = readonly [row: Row, row: Row, row: Row];
type Row = readonly [number, number, number];

const rec709 = [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329];
/** What states that the three channels are X, Y and Z themselves. */
const cieXyz = [1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3];
/** Greatest difference of a coordinate up to which primaries are those of Rec. 709; writers round them. */
const same = 2e-3;
const bradford: Matrix = [
  [0.8951, 0.2664, -0.1614],
  [-0.7502, 1.7135, 0.0367],
  [0.0389, -0.0685, 1.0296],
];

/**
 * Return the matrix from linear colours of these primaries, CIE x and y of red, green, blue and white, to Rec. 709:
 * null where they are the same, undefined where the numbers are no primaries.
 */
export function rec709Matrix(stated: readonly number[]): Matrix | null | undefined {
  if (stated.length !== 8 || !stated.every(Number.isFinite)) return undefined;
  if (stated.every((value, at) => Math.abs(value - rec709[at]!) < same)) return null;
  // Tristimulus values are of no white, so there is none to adapt.
  if (stated.every((value, at) => Math.abs(value - cieXyz[at]!) < same)) return inverse(xyzFromRgb(rec709)!);
  const theirs = xyzFromRgb(stated);
  if (theirs === undefined) return undefined;
  const ours = xyzFromRgb(rec709)!;
  const white = times(bradford, sums(ours));
  const theirWhite = times(bradford, sums(theirs));
  if (theirWhite.some((value) => Math.abs(value) < 1e-3)) return undefined;
  const cones = product(bradford, theirs);
  const scaled = cones.map((row, at) =>
    row.map((value) => (value * white[at]!) / theirWhite[at]!),
  ) as unknown as Matrix;
  return product(inverse(ours), product(inverse(bradford), scaled));
}

/**
 * Convert colours, three values each, in place. Colours outside Rec. 709 get a negative channel, which becomes 0;
 * where a stored value is negative, infinite or NaN already, all three stay as computed, so that checks find them.
 */
export function toRec709(rgb: Float32Array, matrix: Matrix | null): void {
  if (matrix === null) return;
  for (let at = 0; at < rgb.length; at += 3) {
    const [red, green, blue] = [rgb[at]!, rgb[at + 1]!, rgb[at + 2]!];
    const sound = red >= 0 && green >= 0 && blue >= 0 && Number.isFinite(red + green + blue);
    for (let channel = 0; channel < 3; channel++) {
      const row = matrix[channel]!;
      const value = row[0] * red + row[1] * green + row[2] * blue;
      rgb[at + channel] = sound ? Math.max(value, 0) : value;
    }
  }
}

function xyzFromRgb(stated: readonly number[]): Matrix | undefined {
  const corners = [0, 2, 4, 6].map((at) => [stated[at]!, stated[at + 1]!, 1 - stated[at]! - stated[at + 1]!]);
  const white = corners[3]!;
  const matrix = [0, 1, 2].map((axis) =>
    corners.slice(0, 3).map((corner) => corner[axis]!),
  ) as unknown as Matrix;
  if (Math.abs(white[1]!) < 1e-3 || Math.abs(determinant(matrix)) < 1e-4) return undefined;
  const shares = times(inverse(matrix), white.map((value) => value / white[1]!) as unknown as Row);
  return matrix.map((row) => row.map((value, at) => value * shares[at]!)) as unknown as Matrix;
}

function sums(matrix: Matrix): Row {
  return matrix.map((row) => row[0] + row[1] + row[2]) as unknown as Row;
}

function times(matrix: Matrix, vector: Row): Row {
  return matrix.map((row) => row.reduce((sum, value, at) => sum + value * vector[at]!, 0)) as unknown as Row;
}

function product(one: Matrix, other: Matrix): Matrix {
  return one.map((row) =>
    [0, 1, 2].map((at) => row[0] * other[0][at]! + row[1] * other[1][at]! + row[2] * other[2][at]!),
  ) as unknown as Matrix;
}

function determinant([a, b, c]: Matrix): number {
  return (
    a[0] * (b[1] * c[2] - b[2] * c[1]) -
    a[1] * (b[0] * c[2] - b[2] * c[0]) +
    a[2] * (b[0] * c[1] - b[1] * c[0])
  );
}

function inverse([a, b, c]: Matrix): Matrix {
  const scale = 1 / determinant([a, b, c]);
  const cross = (one: Row, other: Row): Row => [
    one[1] * other[2] - one[2] * other[1],
    one[2] * other[0] - one[0] * other[2],
    one[0] * other[1] - one[1] * other[0],
  ];
  const columns = [cross(b, c), cross(c, a), cross(a, b)];
  return [0, 1, 2].map((row) => columns.map((column) => column[row]! * scale)) as unknown as Matrix;
}
