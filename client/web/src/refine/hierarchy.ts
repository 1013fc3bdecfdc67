/**
 * A hierarchy of boxes over triangles: `lambent_relight.tracing.hierarchy`, of single precision as there.
 *
 * Faces are split by the surface area heuristic over 16 bins along the longest side of their centres, down to
 * leaves of four. Source: Wald 2007 (On fast Construction of SAH-based Bounding Volume Hierarchies).
 */

import { hierarchyGrown, hierarchyMaxDepth, leafFaces, numBins } from "../contract/constants.js";

/** Inner nodes, and the faces in the order of the leaves; node 0 is the root. */
export type Hierarchy = {
  /** Lowest and highest corner of either child: twelve numbers per node. */
  readonly boxes: Float32Array<ArrayBuffer>;
  /** Two per node: the number of a node, or -1 - the first face of a leaf. */
  readonly children: Int32Array<ArrayBuffer>;
  /** Two per node: faces of a leaf, 0 for a node. */
  readonly counts: Int32Array<ArrayBuffer>;
  /** First corner and both edges from it, nine numbers per face. */
  readonly corners: Float32Array<ArrayBuffer>;
  /** Number of each face in the mesh. */
  readonly face: Uint32Array<ArrayBuffer>;
};

/** Return the hierarchy of triangles over `positions`; there must be one triangle at least. */
export function buildHierarchy(positions: Float32Array, indices: ArrayLike<number>): Hierarchy {
  const numFaces = indices.length / 3;
  const faceBoxes = boxesOf(positions, indices);
  const order = Uint32Array.from({ length: numFaces }, (_, face) => face);
  const centres = new Float32Array(3 * numFaces);
  for (let face = 0; face < numFaces; face++) {
    for (let axis = 0; axis < 3; axis++) {
      centres[3 * face + axis] = 0.5 * (faceBoxes[6 * face + axis]! + faceBoxes[6 * face + 3 + axis]!);
    }
  }
  const most = Math.max(numFaces, 2);
  const boxes = new Float32Array(12 * most);
  const children = new Int32Array(2 * most);
  const counts = new Int32Array(2 * most);
  const splitter = new Splitter(faceBoxes, centres, order);
  const waiting = [{ node: 0, start: 0, end: numFaces, depth: 0 }];
  let used = 1;
  for (let group = waiting.pop(); group !== undefined; group = waiting.pop()) {
    const { node, start, end, depth } = group;
    const middle =
      depth < hierarchyMaxDepth && end - start > 1
        ? splitter.split(start, end)
        : Math.ceil((start + end) / 2);
    for (const side of [0, 1]) {
      const [from, to] = side === 0 ? [start, middle] : [middle, end];
      bound(faceBoxes, order, from, to, boxes, 12 * node + 6 * side);
      if (to - from <= leafFaces) {
        children[2 * node + side] = -1 - from;
        // A leaf without a face has an empty box, which no ray enters.
        counts[2 * node + side] = Math.max(to - from, 0);
      } else {
        children[2 * node + side] = used;
        waiting.push({ node: used++, start: from, end: to, depth: depth + 1 });
      }
    }
  }
  return {
    boxes: boxes.slice(0, 12 * used),
    children: children.slice(0, 2 * used),
    counts: counts.slice(0, 2 * used),
    corners: cornersOf(positions, indices, order),
    face: order,
  };
}

function boxesOf(positions: Float32Array, indices: ArrayLike<number>): Float32Array {
  const numFaces = indices.length / 3;
  const boxes = new Float32Array(6 * numFaces);
  let size = 0;
  for (let axis = 0; axis < 3; axis++) {
    let [low, high] = [Infinity, -Infinity];
    for (let at = axis; at < positions.length; at += 3) {
      low = Math.min(low, positions[at]!);
      high = Math.max(high, positions[at]!);
    }
    size = Math.max(size, high - low);
  }
  const margin = hierarchyGrown * Math.max(size, 1e-30);
  for (let face = 0; face < numFaces; face++) {
    for (let axis = 0; axis < 3; axis++) {
      const [a, b, c] = [0, 1, 2].map((corner) => positions[3 * indices[3 * face + corner]! + axis]!);
      boxes[6 * face + axis] = Math.min(a!, b!, c!) - margin;
      boxes[6 * face + 3 + axis] = Math.max(a!, b!, c!) + margin;
    }
  }
  return boxes;
}

function cornersOf(
  positions: Float32Array,
  indices: ArrayLike<number>,
  order: Uint32Array,
): Float32Array<ArrayBuffer> {
  const corners = new Float32Array(9 * order.length);
  order.forEach((face, place) => {
    for (let axis = 0; axis < 3; axis++) {
      const first = positions[3 * indices[3 * face]! + axis]!;
      corners[9 * place + axis] = first;
      corners[9 * place + 3 + axis] = positions[3 * indices[3 * face + 1]! + axis]! - first;
      corners[9 * place + 6 + axis] = positions[3 * indices[3 * face + 2]! + axis]! - first;
    }
  });
  return corners;
}

/** Write the box around the faces from `start` to `end`: an empty one where there are none. */
function bound(
  boxes: Float32Array,
  order: Uint32Array,
  start: number,
  end: number,
  out: Float32Array,
  at: number,
): void {
  empty(out, at);
  for (let index = start; index < end; index++) join(boxes, 6 * order[index]!, out, at);
}

function empty(box: Float32Array, at: number): void {
  box.fill(Infinity, at, at + 3).fill(-Infinity, at + 3, at + 6);
}

function join(from: Float32Array, fromAt: number, into: Float32Array, at: number): void {
  for (let axis = 0; axis < 3; axis++) {
    into[at + axis] = Math.min(into[at + axis]!, from[fromAt + axis]!);
    into[at + 3 + axis] = Math.max(into[at + 3 + axis]!, from[fromAt + 3 + axis]!);
  }
}

function halfArea(box: Float32Array): number {
  const [x, y, z] = [box[3]! - box[0]!, box[4]! - box[1]!, box[5]! - box[2]!];
  return x * y + y * z + z * x;
}

/** Sorts faces into two groups. */
class Splitter {
  readonly #counts = new Uint32Array(numBins);
  readonly #bounds = new Float32Array(6 * numBins);
  readonly #above = new Float64Array(numBins);
  readonly #box = new Float32Array(6);

  constructor(
    private readonly boxes: Float32Array,
    private readonly centres: Float32Array,
    private readonly order: Uint32Array,
  ) {}

  /** Sort the faces from `start` to `end` and return where the second group begins. */
  split(start: number, end: number): number {
    const middle = Math.floor((start + end) / 2);
    const { axis, low, width } = this.#longest(start, end);
    if (width <= 0) return middle;
    const scale = numBins / width;
    const bin = (face: number): number =>
      Math.min(Math.floor((this.centres[3 * face + axis]! - low) * scale), numBins - 1);
    this.#fill(start, end, bin);
    const border = this.#border(end - start);
    if (border === 0) return middle;
    let [left, right] = [start, end - 1];
    while (left <= right) {
      const face = this.order[left]!;
      if (bin(face) < border) left++;
      else {
        this.order[left] = this.order[right]!;
        this.order[right--] = face;
      }
    }
    return left;
  }

  #longest(start: number, end: number) {
    let best = { axis: 0, low: 0, width: -1 };
    for (let axis = 0; axis < 3; axis++) {
      let [low, high] = [Infinity, -Infinity];
      for (let index = start; index < end; index++) {
        const centre = this.centres[3 * this.order[index]! + axis]!;
        low = Math.min(low, centre);
        high = Math.max(high, centre);
      }
      if (high - low > best.width) best = { axis, low, width: high - low };
    }
    return best;
  }

  #fill(start: number, end: number, bin: (face: number) => number): void {
    this.#counts.fill(0);
    for (let index = 0; index < numBins; index++) empty(this.#bounds, 6 * index);
    for (let index = start; index < end; index++) {
      const face = this.order[index]!;
      const place = bin(face);
      this.#counts[place]!++;
      join(this.boxes, 6 * face, this.#bounds, 6 * place);
    }
  }

  /** Return the first bin of the second group of least cost, or 0 where all faces are in one bin. */
  #border(count: number): number {
    const box = this.#box;
    empty(box, 0);
    let total = 0;
    this.#above.fill(Infinity);
    for (let index = numBins - 1; index > 0; index--) {
      total += this.#counts[index]!;
      join(this.#bounds, 6 * index, box, 0);
      if (total > 0) this.#above[index] = total * halfArea(box);
    }
    empty(box, 0);
    total = 0;
    let [best, border] = [Infinity, 0];
    for (let index = 0; index < numBins - 1; index++) {
      total += this.#counts[index]!;
      join(this.#bounds, 6 * index, box, 0);
      if (total === 0 || total === count) continue;
      const cost = total * halfArea(box) + this.#above[index + 1]!;
      if (cost < best) [best, border] = [cost, index + 1];
    }
    return border;
  }
}
