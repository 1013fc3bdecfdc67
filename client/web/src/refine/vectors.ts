/** Vectors as arrays of three that are written into. */

/** Three numbers. */
export type Vector = Float64Array;

/** Return a vector of zeros. */
export function vector(): Vector {
  return new Float64Array(3);
}

/** Read element `index` of an array of triples. */
export function readVector(from: Float32Array, index: number, out: Vector): void {
  out[0] = from[3 * index]!;
  out[1] = from[3 * index + 1]!;
  out[2] = from[3 * index + 2]!;
}

/** Write the mirror direction 2 (n.o) n - o. */
export function mirrorOf(normal: Vector, omegaO: Vector, out: Vector): void {
  const twice = 2 * (normal[0]! * omegaO[0]! + normal[1]! * omegaO[1]! + normal[2]! * omegaO[2]!);
  for (let axis = 0; axis < 3; axis++) out[axis] = twice * normal[axis]! - omegaO[axis]!;
}

/** Rows of a rotation, nine numbers. */
export type Rotation = readonly number[];

/** Write the product of a rotation with a vector; with `transposed`, of its inverse. */
export function rotated(matrix: Rotation, from: Vector, out: Vector, transposed = false): void {
  const [x, y, z] = [from[0]!, from[1]!, from[2]!];
  const [row, column] = transposed ? [1, 3] : [3, 1];
  for (let axis = 0; axis < 3; axis++) {
    const start = row * axis;
    out[axis] = matrix[start]! * x + matrix[start + column]! * y + matrix[start + 2 * column]! * z;
  }
}
