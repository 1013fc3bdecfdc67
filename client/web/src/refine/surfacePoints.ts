/** The surface behind the samples of a picture, from the mesh that the viewer draws and the bundle's texels. */

import { type HitTransport, tableWidth } from "../bundle/transport.js";
import type { MaterialEdit, ViewCamera } from "../render/looks.js";
import { alphaOf } from "./reflection.js";

/** Points that reflect light towards `omegaO`, triples and numbers per point. */
export type SurfacePoints = {
  readonly count: number;
  /** Pixel of the picture, row * width + column from the top. */
  readonly pixel: Uint32Array;
  readonly position: Float32Array;
  readonly normal: Float32Array;
  readonly omegaO: Float32Array;
  readonly albedo: Float32Array;
  readonly alpha: Float32Array;
  readonly metalness: Float32Array;
};

/** Samples of a picture that show the surface; `samples` x `samples` to a pixel. */
export type SurfaceSamples = {
  readonly camera: ViewCamera;
  readonly samples: number;
  /** Place in the grid of all samples, row * (width samples) + column from the top. */
  readonly place: Uint32Array<ArrayBuffer>;
  /** Octahedral, two halves of 16 bits, as the surface's shader packs them. */
  readonly normal: Uint32Array<ArrayBuffer>;
  /** From the camera, scene units. */
  readonly distance: Float32Array<ArrayBuffer>;
  /** Pairs as the surface's shader packs albedo, roughness and metalness. */
  readonly material: Uint32Array<ArrayBuffer>;
};

/** Changes to the bundle's material, with the bundle's own factor on albedo. */
export type RefineEdit = MaterialEdit & { readonly albedoScaleRgb: readonly number[] };

/** Texels' materials as numbers. */
export type TexelMaterials = {
  readonly albedo: Float32Array;
  readonly perceptualRoughness: Float32Array;
  readonly metalness: Float32Array;
  readonly normal: Float32Array;
};

const clip = (value: number): number => Math.min(Math.max(value, 0), 1);

/** Return the materials of a bundle's texels. */
export function texelMaterials({ material, numTexels }: HitTransport): TexelMaterials {
  const albedo = new Float32Array(3 * numTexels);
  const perceptualRoughness = new Float32Array(numTexels);
  const metalness = new Float32Array(numTexels);
  const normal = new Float32Array(3 * numTexels);
  const layer = 4 * material.rows * tableWidth;
  for (let texel = 0; texel < numTexels; texel++) {
    const at = (plane: number): number =>
      material.offsets[plane]! +
      material.scales[plane]! * material.steps[(plane >> 2) * layer + 4 * texel + (plane & 3)]!;
    for (let axis = 0; axis < 3; axis++) albedo[3 * texel + axis] = clip(at(axis));
    perceptualRoughness[texel] = clip(at(3));
    metalness[texel] = clip(at(4));
    const length = Math.max(Math.hypot(at(5), at(6), at(7)), 1e-10);
    for (let axis = 0; axis < 3; axis++) normal[3 * texel + axis] = at(5 + axis) / length;
  }
  return { albedo, perceptualRoughness, metalness, normal };
}

/** Return materials with an edit applied, as `lambent_relight.edits` does. */
export function edited(materials: TexelMaterials, edit: RefineEdit): TexelMaterials {
  const gain = edit.albedoGain.map((value, channel) => value * edit.albedoScaleRgb[channel]!);
  return {
    albedo: materials.albedo.map((value, index) => clip(value * gain[index % 3]!)),
    perceptualRoughness: materials.perceptualRoughness.map((value) => clip(value * edit.roughnessScale)),
    metalness: materials.metalness.map((value) => clip(value + edit.metalnessShift)),
    normal: materials.normal,
  };
}

/** Return the points of the samples of a picture, their materials edited. */
export function surfacePoints(seen: SurfaceSamples, edit: RefineEdit): SurfacePoints {
  const { camera, samples, place, distance } = seen;
  const count = place.length;
  const pose = camera.cameraToWorld;
  const points = {
    count,
    pixel: new Uint32Array(count),
    position: new Float32Array(3 * count),
    normal: new Float32Array(3 * count),
    omegaO: new Float32Array(3 * count),
    albedo: new Float32Array(3 * count),
    alpha: new Float32Array(count),
    metalness: new Float32Array(count),
  };
  const across = camera.width * samples;
  for (let index = 0; index < count; index++) {
    const row = Math.floor(place[index]! / across);
    const column = place[index]! - row * across;
    points.pixel[index] = Math.floor(row / samples) * camera.width + Math.floor(column / samples);
    const x = ((column + 0.5) / samples - camera.centreX) / camera.focalX;
    const y = -((row + 0.5) / samples - camera.centreY) / camera.focalY;
    const length = Math.sqrt(x * x + y * y + 1);
    const normal = unfolded(seen.normal[index]!);
    let facing = 0;
    for (let axis = 0; axis < 3; axis++) {
      const away = (pose[4 * axis]! * x + pose[4 * axis + 1]! * y - pose[4 * axis + 2]!) / length;
      points.omegaO[3 * index + axis] = -away;
      points.position[3 * index + axis] = pose[4 * axis + 3]! + distance[index]! * away;
      points.normal[3 * index + axis] = normal[axis]!;
      facing -= away * normal[axis]!;
    }
    if (facing < 1e-3) turnTowards(points.normal, points.omegaO, index, facing);
    unpack(points, index, seen.material[2 * index]!, seen.material[2 * index + 1]!, edit);
  }
  return points;
}

/** Return the unit vector of two octahedral halves, signed. */
export function unfolded(halves: number): [x: number, y: number, z: number] {
  const half = (bits: number): number => Math.max(((bits << 16) >> 16) / 32767, -1);
  let [x, y] = [half(halves), half(halves >>> 16)];
  const z = 1 - Math.abs(x) - Math.abs(y);
  if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x >= 0 ? 1 : -1), (1 - Math.abs(x)) * (y >= 0 ? 1 : -1)];
  const length = Math.hypot(x, y, z);
  return [x / length, y / length, z / length];
}

/** Set the material of a point from the two words of its sample. */
function unpack(points: SurfacePoints, index: number, low: number, high: number, edit: RefineEdit): void {
  [low & 0xffff, low >>> 16, high & 0xffff].forEach((level, axis) => {
    const gain = edit.albedoGain[axis]! * edit.albedoScaleRgb[axis]!;
    points.albedo[3 * index + axis] = clip((level / 65535) * gain);
  });
  points.alpha[index] = alphaOf(clip((((high >>> 16) & 0xff) / 255) * edit.roughnessScale));
  points.metalness[index] = clip((high >>> 24) / 255 + edit.metalnessShift);
}

/** A normal may face away where the mesh does not: bring it to the edge of what is seen. */
function turnTowards(normal: Float32Array, omegaO: Float32Array, index: number, facing: number): void {
  let length = 0;
  for (let axis = 3 * index; axis < 3 * index + 3; axis++) {
    normal[axis] = normal[axis]! - (facing - 1e-3) * omegaO[axis]!;
    length += normal[axis]! ** 2;
  }
  for (let axis = 3 * index; axis < 3 * index + 3; axis++) normal[axis] = normal[axis]! / Math.sqrt(length);
}
