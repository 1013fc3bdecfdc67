/** World positions of an atlas's texels: `texel_positions` of `lambent_relight.baked.scene`. */

import type { AtlasMesh } from "../bundle/mesh.js";
import { exportAgain } from "../page/fault.js";
import { spreadTexels } from "../bundle/texels.js";
import type { PackedTransport } from "../bundle/transport.js";
import { bundleFaults, fillIn } from "../words/words.js";

/**
 * Return the position of every covered texel's centre on the mesh, triples; throws BundleFault where the mesh covers
 * none. A texel that the mesh does not cover takes the position of the nearest one it does cover.
 */
export function texelPositions(mesh: AtlasMesh, transport: PackedTransport): Float32Array {
  const { size, numTexels, texelPlane } = transport;
  const drawn = drawCharts(mesh, size);
  if (drawn.places.length === 0)
    throw exportAgain("bundle.mesh_invalid", fillIn(bundleFaults.mesh, { what: bundleFaults.coversNothing }));
  const positions = new Float32Array(3 * numTexels);
  const known = new Uint8Array(numTexels);
  const place = new Int32Array(numTexels).fill(-1);
  texelPlane.forEach((texel, at) => {
    if (place[texel] === -1) place[texel] = at;
  });
  drawn.places.forEach((at, index) => {
    const texel = texelPlane[at]!;
    if (known[texel] === 1) return;
    known[texel] = 1;
    positions.set(drawn.positions.subarray(3 * index, 3 * index + 3), 3 * texel);
  });
  if (known.every((value) => value === 1)) return positions;
  const nearest = spreadTexels(drawn.places, size);
  known.forEach((value, texel) => {
    if (value === 1) return;
    const index = nearest[place[texel]!]!;
    positions.set(drawn.positions.subarray(3 * index, 3 * index + 3), 3 * texel);
  });
  return positions;
}

/** Return the places whose centres lie in a triangle, rising, and the world's positions there. */
function drawCharts(mesh: AtlasMesh, size: number): { places: Uint32Array; positions: Float32Array } {
  const { indices, uv, positionsXyz } = mesh;
  const face = new Int32Array(size * size).fill(-1);
  const weights = new Float32Array(2 * size * size);
  for (let first = 0; first < indices.length; first += 3) {
    const corner = (index: number): [x: number, y: number] => {
      const vertex = indices[first + index]!;
      return [uv[2 * vertex]! * size, uv[2 * vertex + 1]! * size];
    };
    const [[ax, ay], [bx, by], [cx, cy]] = [corner(0), corner(1), corner(2)];
    const left = Math.max(0, Math.trunc(Math.min(ax, bx, cx) - 1.5));
    const right = Math.min(size - 1, Math.trunc(Math.max(ax, bx, cx) + 0.5));
    const top = Math.max(0, Math.trunc(Math.min(ay, by, cy) - 1.5));
    const bottom = Math.min(size - 1, Math.trunc(Math.max(ay, by, cy) + 0.5));
    for (let row = top; row <= bottom; row++) {
      const y = row + 0.5;
      for (let column = left; column <= right; column++) {
        const at = row * size + column;
        if (face[at]! >= 0) continue;
        const x = column + 0.5;
        const ea = (bx - x) * (cy - y) - (by - y) * (cx - x);
        const eb = (cx - x) * (ay - y) - (cy - y) * (ax - x);
        const ec = (ax - x) * (by - y) - (ay - y) * (bx - x);
        const inside = (ea >= 0 && eb >= 0 && ec >= 0) || (ea <= 0 && eb <= 0 && ec <= 0);
        const total = ea + eb + ec;
        if (!inside || total === 0) continue;
        face[at] = first;
        weights[2 * at] = eb / total;
        weights[2 * at + 1] = ec / total;
      }
    }
  }
  const places = Uint32Array.from(face.keys()).filter((at) => face[at]! >= 0);
  const positions = new Float32Array(3 * places.length);
  places.forEach((at, index) => {
    const corners = [0, 1, 2].map((corner) => 3 * indices[face[at]! + corner]!);
    for (let axis = 0; axis < 3; axis++) {
      const [a, b, c] = corners.map((start) => positionsXyz[start + axis]!) as [number, number, number];
      positions[3 * index + axis] = a + weights[2 * at]! * (b - a) + weights[2 * at + 1]! * (c - a);
    }
  });
  return { places, positions };
}
