/**
 * Exact rays against a triangle mesh: `lambent_relight.tracing`.
 *
 * A closed surface is met from outside only: a ray that starts a little below it, because materials and meshes never
 * agree on where it is, leaves through it and is not blocked by itself. Source: Möller and Trumbore 1997 (ray against
 * triangle).
 */

import { tracingStack } from "../contract/constants.js";
import type { AtlasMesh } from "../bundle/mesh.js";
import { buildHierarchy, type Hierarchy } from "./hierarchy.js";

/** Finds what rays meet on a mesh. */
export class MeshRays {
  readonly oneSided: boolean;
  readonly #tree: Hierarchy;
  /** Nodes that wait: one per level, and no hierarchy is as deep. */
  readonly #stack = new Int32Array(tracingStack);
  /** Of the last ray: the face that it met, -1 for none, and the weights there of its second and third corner. */
  face = -1;
  u = 0;
  v = 0;

  constructor({ positionsXyz, indices }: Pick<AtlasMesh, "positionsXyz" | "indices">) {
    this.#tree = buildHierarchy(positionsXyz, indices);
    this.oneSided = isClosed(positionsXyz, indices);
  }

  /** Return the distance of the first face in the way of a ray along a unit direction; infinite where there is none. */
  distance(ox: number, oy: number, oz: number, dx: number, dy: number, dz: number): number {
    const { boxes, children, counts, corners } = this.#tree;
    const stack = this.#stack;
    const { oneSided } = this;
    const [ix, iy, iz] = [inverse(dx), inverse(dy), inverse(dz)];
    let nearest = Infinity;
    let [best, bestU, bestV] = [-1, 0, 0];
    let size = 0;
    let node = 0;
    for (;;) {
      const at = 12 * node;
      const left = enters(boxes, at, ox, oy, oz, ix, iy, iz, nearest);
      const right = enters(boxes, at + 6, ox, oy, oz, ix, iy, iz, nearest);
      let following = -1;
      for (let turn = 0; turn < 2; turn++) {
        const side = left <= right ? turn : 1 - turn;
        if ((side === 0 ? left : right) === Infinity) continue;
        const child = children[2 * node + side]!;
        if (child > 0) {
          if (following < 0) following = child;
          else stack[size++] = child;
          continue;
        }
        const begin = -1 - child;
        const end = begin + counts[2 * node + side]!;
        for (let place = begin; place < end; place++) {
          const c = 9 * place;
          const e1x = corners[c + 3]!,
            e1y = corners[c + 4]!,
            e1z = corners[c + 5]!;
          const e2x = corners[c + 6]!,
            e2y = corners[c + 7]!,
            e2z = corners[c + 8]!;
          const px = dy * e2z - dz * e2y,
            py = dz * e2x - dx * e2z,
            pz = dx * e2y - dy * e2x;
          const det = e1x * px + e1y * py + e1z * pz;
          // Positive: the ray meets the side whose corners run counter-clockwise.
          if (det === 0 || (oneSided && det < 0)) continue;
          const over = 1 / det;
          const tx = ox - corners[c]!,
            ty = oy - corners[c + 1]!,
            tz = oz - corners[c + 2]!;
          const u = (tx * px + ty * py + tz * pz) * over;
          if (u < 0 || u > 1) continue;
          const qx = ty * e1z - tz * e1y,
            qy = tz * e1x - tx * e1z,
            qz = tx * e1y - ty * e1x;
          const v = (dx * qx + dy * qy + dz * qz) * over;
          if (v < 0 || u + v > 1) continue;
          const t = (e2x * qx + e2y * qy + e2z * qz) * over;
          if (t > 0 && t < nearest) {
            nearest = t;
            best = place;
            bestU = u;
            bestV = v;
          }
        }
      }
      if (following >= 0) node = following;
      else if (size > 0) node = stack[--size]!;
      else break;
    }
    this.face = best < 0 ? -1 : this.#tree.face[best]!;
    this.u = bestU;
    this.v = bestV;
    return nearest;
  }
}

// A ray along an axis would meet 0 times infinity at a box's border.
function inverse(x: number): number {
  return Math.abs(x) < 1e-12 ? (x >= 0 ? 1e12 : -1e12) : 1 / x;
}

/** Return the distance at which a ray enters a box before `nearest`, or infinity. */
function enters(
  boxes: Float32Array,
  at: number,
  ox: number,
  oy: number,
  oz: number,
  ix: number,
  iy: number,
  iz: number,
  nearest: number,
): number {
  const ax = (boxes[at]! - ox) * ix,
    bx = (boxes[at + 3]! - ox) * ix;
  const ay = (boxes[at + 1]! - oy) * iy,
    by = (boxes[at + 4]! - oy) * iy;
  const az = (boxes[at + 2]! - oz) * iz,
    bz = (boxes[at + 5]! - oz) * iz;
  const enter = Math.max(Math.min(ax, bx), Math.min(ay, by), Math.min(az, bz), 0);
  const leave = Math.min(Math.max(ax, bx), Math.max(ay, by), Math.max(az, bz), nearest);
  return enter <= leave ? enter : Infinity;
}

/**
 * Return whether every edge has as many faces on one side as on the other. Vertices at the same place are one: an
 * atlas doubles them along its seams.
 */
export function isClosed(positions: Float32Array, indices: ArrayLike<number>): boolean {
  const places = new Map<string, number>();
  const numVertices = positions.length / 3;
  const numberOf = new Uint32Array(numVertices);
  for (let vertex = 0; vertex < numVertices; vertex++) {
    const key = `${positions[3 * vertex]},${positions[3 * vertex + 1]},${positions[3 * vertex + 2]}`;
    const known = places.get(key);
    if (known === undefined) places.set(key, places.size);
    numberOf[vertex] = known ?? places.size - 1;
  }
  const balance = new Map<number, number>();
  for (let corner = 0; corner < indices.length; corner++) {
    const next = corner % 3 === 2 ? corner - 2 : corner + 1;
    const [start, end] = [numberOf[indices[corner]!]!, numberOf[indices[next]!]!];
    const edge = Math.min(start, end) * numVertices + Math.max(start, end);
    balance.set(edge, (balance.get(edge) ?? 0) + Math.sign(end - start));
  }
  for (const sum of balance.values()) if (sum !== 0) return false;
  return true;
}
