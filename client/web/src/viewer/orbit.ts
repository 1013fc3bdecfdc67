/** Steps of the camera and the light, and the keys for them. */

import type { LightTurn } from "../render/looks.js";
import { axesOf } from "./camera.js";
import { limits, type OrbitPose, within, wrapped } from "./state.js";

/** The thing being rotated. */
export type Turned = { readonly pose: OrbitPose; readonly turn: LightTurn };

const keyDegrees = 5;

type Range = readonly [least: number, most: number];

/** Return a pose turned by some degrees; its elevation stays in a range, or goes back there. */
export function orbited(
  pose: OrbitPose,
  azimuth: number,
  elevation: number,
  [least, most]: Range = limits.elevation,
): OrbitPose {
  const { elevationDeg } = pose;
  // A pose outside, which a link may have, does not jump.
  const range = [Math.min(least, elevationDeg), Math.max(most, elevationDeg)] as const;
  return {
    ...pose,
    azimuthDeg: wrapped(pose.azimuthDeg + azimuth),
    elevationDeg: within(elevationDeg + elevation, range, 0),
  };
}

/** Return a pose nearer (factor below 1) or further. */
export function zoomed(pose: OrbitPose, factor: number): OrbitPose {
  return { ...pose, distance: within(pose.distance * factor, limits.distance, pose.distance) };
}

/** Return a pose whose target moved in the picture's plane, in shares of the distance. */
export function panned(pose: OrbitPose, right: number, up: number): OrbitPose {
  const axes = axesOf(pose);
  const move = [0, 1, 2].map((axis) => axes.right[axis]! * right + axes.up[axis]! * up);
  const [x, y, z] = pose.target.map((value, axis) => within(value + pose.distance * move[axis]!, [-5, 5], 0));
  return { ...pose, target: [x!, y!, z!] };
}

type Key = Pick<KeyboardEvent, "key" | "shiftKey" | "altKey" | "ctrlKey" | "metaKey">;

/** Return the change of a key, or null if it has no function here. */
export function afterKey(
  event: Key,
  { pose, turn }: Turned,
  elevation: Range = limits.elevation,
): Partial<Turned> | null {
  if (event.altKey || event.ctrlKey || event.metaKey) return null;
  const { key, shiftKey } = event;
  const light = (degrees: number) => ({ turn: { ...turn, yawDeg: wrapped(turn.yawDeg + degrees) } });
  const across = { ArrowLeft: -1, ArrowRight: 1 }[key];
  if (across !== undefined) {
    return shiftKey ? light(across * keyDegrees) : { pose: orbited(pose, across * keyDegrees, 0) };
  }
  const up = { ArrowUp: 1, ArrowDown: -1 }[key];
  if (up !== undefined) {
    return { pose: shiftKey ? panned(pose, 0, up * 0.03) : orbited(pose, 0, up * keyDegrees, elevation) };
  }
  if (key === "[" || key === "]") return light(key === "[" ? -keyDegrees : keyDegrees);
  const nearer = { "+": 1 / 1.1, "=": 1 / 1.1, "-": 1.1 }[key];
  return nearer === undefined ? null : { pose: zoomed(pose, nearer) };
}
