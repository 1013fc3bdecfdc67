/** Finds a nearest point among many on a surface: `NearestPoint` of `lambent_relight.baked.transport_kernels`. */

import { boundsOf } from "../bundle/mesh.js";
import { grouped } from "./grouped.js";

/** Exact beside the surface, nearly so far from it. */
export class NearestPoint {
  readonly #low: readonly [number, number, number];
  readonly #shape: readonly [number, number, number];
  readonly #cell: number;
  /** Points by cell, and their positions. */
  readonly #order: Uint32Array;
  readonly #sorted: Float32Array;
  readonly #first: Uint32Array;
  /** The nearest occupied cell of every cell. */
  readonly #home: Int32Array;

  /** `points` are triples; there must be one at least. */
  constructor(points: Float32Array) {
    const numPoints = points.length / 3;
    const { boundsMin: low, boundsMax: high } = boundsOf(points);
    const extent = low.map((value, axis) => Math.max(high[axis]! - value, 1e-6));
    // About as many cells along a side as give a surface's points two or three to a cell.
    const count = Math.min(Math.max(Math.sqrt(numPoints / 6), 1), 96);
    const cell = Math.max(...extent) / count;
    this.#cell = cell;
    // A rim of empty cells, so that neighbours need no check.
    this.#low = [low[0]! - cell, low[1]! - cell, low[2]! - cell];
    const side = (axis: number): number => Math.floor(extent[axis]! / cell) + 3;
    this.#shape = [side(0), side(1), side(2)];
    const numCells = this.#shape[0] * this.#shape[1] * this.#shape[2];
    const number = new Uint32Array(numPoints);
    for (let point = 0; point < numPoints; point++) {
      const [i, j, k] = [0, 1, 2].map((axis) =>
        Math.min(Math.floor((points[3 * point + axis]! - this.#low[axis]!) / cell), this.#shape[axis]! - 2),
      );
      number[point] = (i! * this.#shape[1] + j!) * this.#shape[2] + k!;
    }
    ({ order: this.#order, first: this.#first } = grouped(number, numCells));
    this.#sorted = new Float32Array(3 * numPoints);
    this.#order.forEach((point, place) => {
      this.#sorted.set(points.subarray(3 * point, 3 * point + 3), 3 * place);
    });
    this.#home = this.#spread(numCells);
  }

  /** Give every cell the nearest occupied one, by flooding outwards from those. */
  #spread(numCells: number): Int32Array {
    const [sizeX, sizeY, sizeZ] = this.#shape;
    const home = new Int32Array(numCells).fill(-1);
    const queue = new Int32Array(numCells);
    let end = 0;
    for (let index = 0; index < numCells; index++) {
      if (this.#first[index + 1]! > this.#first[index]!) {
        home[index] = index;
        queue[end++] = index;
      }
    }
    for (let place = 0; place < end; place++) {
      const index = queue[place]!;
      const i = Math.floor(index / (sizeY * sizeZ));
      const [j, k] = [Math.floor(index / sizeZ) % sizeY, index % sizeZ];
      for (let a = Math.max(i - 1, 0); a <= Math.min(i + 1, sizeX - 1); a++) {
        for (let b = Math.max(j - 1, 0); b <= Math.min(j + 1, sizeY - 1); b++) {
          for (let c = Math.max(k - 1, 0); c <= Math.min(k + 1, sizeZ - 1); c++) {
            const other = (a * sizeY + b) * sizeZ + c;
            if (home[other]! >= 0) continue;
            home[other] = home[index]!;
            queue[end++] = other;
          }
        }
      }
    }
    return home;
  }

  /** Return the index of a point near (x, y, z): the nearest one if that is less than a cell away. */
  at(x: number, y: number, z: number): number {
    const [, sizeY, sizeZ] = this.#shape;
    const inside = (value: number, axis: 0 | 1 | 2): number =>
      Math.min(Math.max(Math.floor((value - this.#low[axis]) / this.#cell), 1), this.#shape[axis] - 2);
    let [i, j, k] = [inside(x, 0), inside(y, 1), inside(z, 2)];
    let found = this.#around(i, j, k, x, y, z);
    if (found < 0) {
      const home = this.#home[(i * sizeY + j) * sizeZ + k]!;
      i = Math.floor(home / (sizeY * sizeZ));
      j = Math.floor(home / sizeZ) % sizeY;
      k = home % sizeZ;
      found = this.#around(i, j, k, x, y, z);
    }
    return this.#order[found]!;
  }

  #around(i: number, j: number, k: number, x: number, y: number, z: number): number {
    const [, sizeY, sizeZ] = this.#shape;
    let [best, found] = [Infinity, -1];
    for (let a = i - 1; a <= i + 1; a++) {
      for (let b = j - 1; b <= j + 1; b++) {
        const row = (a * sizeY + b) * sizeZ + k;
        for (let p = this.#first[row - 1]!; p < this.#first[row + 2]!; p++) {
          const dx = this.#sorted[3 * p]! - x;
          const dy = this.#sorted[3 * p + 1]! - y;
          const dz = this.#sorted[3 * p + 2]! - z;
          const distance = dx * dx + dy * dy + dz * dz;
          if (distance < best) {
            best = distance;
            found = p;
          }
        }
      }
    }
    return found;
  }
}
