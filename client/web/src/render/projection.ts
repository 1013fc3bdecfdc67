/** The projection of a picture. */

import { Matrix4, type PerspectiveCamera } from "three";
import type { LoadedBundle } from "../bundle/load.js";
import { ballOf } from "./ball.js";
import type { ViewCamera } from "./looks.js";

/** Set a camera to a view and return the range of distances of the object. */
export function aim(
  camera: PerspectiveCamera,
  view: ViewCamera,
  { boundsMin, boundsMax }: Pick<LoadedBundle, "boundsMin" | "boundsMax">,
): readonly [near: number, far: number] {
  const pose = view.cameraToWorld;
  const { centre, radius } = ballOf(boundsMin, boundsMax);
  const away = Math.hypot(...centre.map((value, axis) => value - pose[4 * axis + 3]!));
  const near = Math.max(away - radius, 0.01 * radius);
  const far = away + 1.1 * radius;
  const { focalX, focalY, centreX, centreY, width, height } = view;
  const matrix = new Matrix4().fromArray(pose as number[]).transpose();
  camera.matrixWorld.copy(matrix);
  camera.matrixWorldInverse.copy(matrix).invert();
  camera.projectionMatrix.makePerspective(
    (-centreX / focalX) * near,
    ((width - centreX) / focalX) * near,
    (centreY / focalY) * near,
    (-(height - centreY) / focalY) * near,
    near,
    far,
  );
  return [Math.max(away - radius, 0), away + radius];
}
