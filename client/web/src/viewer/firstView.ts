/** The first view of an object: from where it was photographed, as large as fits, and how far one may go around it. */

import type { PhotoCamera } from "../bundle/cameras.js";
import type { LoadedBundle } from "../bundle/load.js";
import { type Ball, ballOf } from "../render/ball.js";
import type { LightTurn } from "../render/looks.js";
import { axesOf, fieldOfViewDeg } from "./camera.js";
import { lightFor } from "./earlyLight.js";
import { turnedFor, turnFor, turnTowards } from "./turning.js";
import { initialState, limits, type OrbitPose, type ViewerState, within } from "./state.js";

/** Share of the picture that the object spans, along the side that it fills most. */
const filled = 0.8;
/** A first view looks down by about this angle, where a photograph does. */
const bestElevationDeg = 20;
/** One may look from this much lower or higher than photographs did. */
const beyondDeg = 15;
const rounds = 24;

/** The pose and the turn of built-in lights that a bundle is opened with. */
type Home = { readonly home: OrbitPose; readonly homeTurn: LightTurn };
type Range = readonly [least: number, most: number];
type Seen = Pick<LoadedBundle, "cameras" | "boundsMin" | "boundsMax" | "mesh">;

/** Return the angles under which a camera stands, seen from the middle of the object, degrees. */
export function anglesOf({ cameraToWorld }: PhotoCamera, { centre }: Ball) {
  const [x, y, z] = [0, 1, 2].map((axis) => cameraToWorld[4 * axis + 3]! - centre[axis]!);
  return {
    azimuthDeg: (Math.atan2(y!, x!) * 180) / Math.PI,
    elevationDeg: (Math.atan2(z!, Math.hypot(x!, y!)) * 180) / Math.PI,
  };
}

/** Return the elevations to look from: those of the photographs and a little more; all where there is no camera. */
export function elevationRange({ cameras, boundsMin, boundsMax }: Omit<Seen, "mesh">): Range {
  if (cameras.length === 0) return limits.elevation;
  const ball = ballOf(boundsMin, boundsMax);
  const found = cameras.map((camera) => anglesOf(camera, ball).elevationDeg);
  const at = (angle: number): number => within(angle, limits.elevation, 0);
  return [at(Math.min(...found) - beyondDeg), at(Math.max(...found) + beyondDeg)];
}

/** Return the pose that a viewer opens with, for a picture of some shape. */
export function firstPose(bundle: Seen, width: number, height: number): OrbitPose {
  const ball = ballOf(bundle.boundsMin, bundle.boundsMax);
  const angles = bundle.cameras
    .map((camera) => anglesOf(camera, ball))
    .sort(
      (a, b) => Math.abs(a.elevationDeg - bestElevationDeg) - Math.abs(b.elevationDeg - bestElevationDeg),
    )[0];
  const pose = { ...initialState.pose, ...angles };
  return framed(pose, ball, bundle.mesh.positionsXyz, width, height);
}

/** Return the state in which a bundle is first shown: what neither a link nor a person has chosen is for this bundle. */
export function firstView(
  { pose, turn, ...state }: ViewerState,
  before: Home,
  bundle: Seen & Pick<LoadedBundle, "trainedMaps">,
  { width, height }: { readonly width: number; readonly height: number },
): Home & { readonly state: ViewerState } {
  const home = firstPose(bundle, width, height);
  const homeTurn = turnTowards(home.azimuthDeg);
  const environment = lightFor(
    state.environment,
    bundle.trainedMaps.map(({ name }) => name),
  );
  const shown = {
    ...state,
    environment,
    pose: pose === before.home ? home : pose,
    turn: turn === before.homeTurn ? turnFor(environment, homeTurn) : turn,
  };
  return { home, homeTurn, state: shown };
}

/** Return a state in an available light: a link may name a map that is gone, and the object is shown all the same. */
export function inAnotherLight(
  state: ViewerState,
  { trainedMaps }: Pick<LoadedBundle, "trainedMaps">,
  home: ViewerState["turn"],
): ViewerState {
  const light = lightFor(
    "",
    trainedMaps.map(({ name }) => name),
  );
  return { ...state, ...turnedFor({ environment: light, environmentB: light }, state, home) };
}

/** Return a pose from the same side whose picture the points fill to 80 %, in the middle. */
export function framed(
  pose: OrbitPose,
  { centre, radius }: Ball,
  positionsXyz: Float32Array,
  width: number,
  height: number,
): OrbitPose {
  const { right, up, back } = axesOf(pose);
  const count = positionsXyz.length / 3;
  const along = (axis: readonly number[]): Float64Array =>
    Float64Array.from({ length: count }, (_, index) => {
      let sum = 0;
      for (let k = 0; k < 3; k++) sum += axis[k]! * (positionsXyz[3 * index + k]! - centre[k]!);
      return sum / radius;
    });
  const [x, y, z] = [along(right), along(up), along(back)];
  // Half of the picture's sides at distance 1.
  const half = Math.tan((fieldOfViewDeg * Math.PI) / 360) / Math.min(width, height);
  const slopes = [filled * half * width, filled * half * height] as const;
  const distance = Math.max(enclose(x!, z!, slopes[0]).distance, enclose(y!, z!, slopes[1]).distance);
  const [atX, atY] = [middle(x!, z!, slopes[0], distance), middle(y!, z!, slopes[1], distance)];
  const target = [0, 1, 2].map((axis) => within(atX * right[axis]! + atY * up[axis]!, [-5, 5], 0));
  return {
    ...pose,
    distance: within(distance, limits.distance, pose.distance),
    target: [target[0]!, target[1]!, target[2]!],
  };
}

/**
 * Return the distance at which two planes through the camera, to either side and as steep as `slope`, hold all points
 * between them, and where the camera then is across its direction.
 */
function enclose(across: Float64Array, back: Float64Array, slope: number): { distance: number; at: number } {
  let [least, most] = [Infinity, -Infinity];
  across.forEach((value, index) => {
    least = Math.min(least, value - slope * back[index]!);
    most = Math.max(most, value + slope * back[index]!);
  });
  return { distance: (most - least) / (2 * slope), at: 0.5 * (least + most) };
}

/** Return where the camera is across its direction, so that at some distance the points are in the middle. */
function middle(across: Float64Array, back: Float64Array, widest: number, distance: number): number {
  let [low, high] = [0, widest];
  for (let round = 0; round < rounds; round++) {
    const slope = 0.5 * (low + high);
    if (enclose(across, back, slope).distance > distance) low = slope;
    else high = slope;
  }
  return enclose(across, back, high).at;
}
