/** The point of the surface that is seen at a place of the picture. */

import type { AtlasMesh } from "../bundle/mesh.js";
import type { ViewCamera } from "../render/looks.js";

type Point = readonly [x: number, y: number, z: number];

/** Return the point of a mesh that a camera sees at column `x` and row `y` of its picture, or null. */
export function pick(
  mesh: Pick<AtlasMesh, "positionsXyz" | "indices">,
  camera: ViewCamera,
  x: number,
  y: number,
): Point | null {
  const pose = camera.cameraToWorld;
  const local = [(x - camera.centreX) / camera.focalX, -(y - camera.centreY) / camera.focalY, -1];
  const along = (row: number): number =>
    pose[4 * row]! * local[0]! + pose[4 * row + 1]! * local[1]! + pose[4 * row + 2]! * local[2]!;
  const direction: Point = [along(0), along(1), along(2)];
  const eye: Point = [pose[3]!, pose[7]!, pose[11]!];
  const distance = nearest(mesh, eye, direction);
  if (distance === null) return null;
  return [
    eye[0] + distance * direction[0],
    eye[1] + distance * direction[1],
    eye[2] + distance * direction[2],
  ];
}

/** Return the distance of the nearest triangle in lengths of `direction`, or null; both sides count (Moeller and Trumbore). */
function nearest(
  { positionsXyz: p, indices }: Pick<AtlasMesh, "positionsXyz" | "indices">,
  [ox, oy, oz]: Point,
  [dx, dy, dz]: Point,
): number | null {
  let least = Number.POSITIVE_INFINITY;
  for (let at = 0; at < indices.length; at += 3) {
    const [a, b, c] = [3 * indices[at]!, 3 * indices[at + 1]!, 3 * indices[at + 2]!];
    const [ax, ay, az] = [p[a]!, p[a + 1]!, p[a + 2]!];
    const [ux, uy, uz] = [p[b]! - ax, p[b + 1]! - ay, p[b + 2]! - az];
    const [vx, vy, vz] = [p[c]! - ax, p[c + 1]! - ay, p[c + 2]! - az];
    const [hx, hy, hz] = [dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx];
    const determinant = ux * hx + uy * hy + uz * hz;
    if (determinant === 0) continue;
    const [sx, sy, sz] = [ox - ax, oy - ay, oz - az];
    const first = (sx * hx + sy * hy + sz * hz) / determinant;
    if (first < 0 || first > 1) continue;
    const [qx, qy, qz] = [sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux];
    const second = (dx * qx + dy * qy + dz * qz) / determinant;
    if (second < 0 || first + second > 1) continue;
    const distance = (vx * qx + vy * qy + vz * qz) / determinant;
    if (distance > 0 && distance < least) least = distance;
  }
  return Number.isFinite(least) ? least : null;
}
