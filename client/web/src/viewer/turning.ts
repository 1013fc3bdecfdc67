/** Turning the light: where it comes from, and turns about any axis. */

import type { Direction } from "../engine/environment.js";
import type { Matrix3 } from "../engine/harmonics.js";
import type { PreparedLight } from "../light/prepare.js";
import { turnMatrix } from "../render/light.js";
import type { LightTurn } from "../render/looks.js";
import { initialState, type ViewerState, wrapped } from "./state.js";

/** Least length of the mean direction, as a share of the whole light, that is one. */
const leastShare = 0.02;
const luminance = [0.2126, 0.7152, 0.0722] as const;

/**
 * Return the direction of a map's brightest dominant light, or of its mean where there is none; null where the light
 * comes from everywhere.
 */
export function mainDirection({
  lights,
  plainRgb,
}: Pick<PreparedLight, "lights" | "plainRgb">): Direction | null {
  if (lights[0] !== undefined) return lights[0].direction;
  const band = (index: number): number =>
    luminance.reduce((sum, weight, channel) => sum + weight * plainRgb[3 * index + channel]!, 0);
  const [all, y, z, x] = [band(0), band(1), band(2), band(3)];
  const length = Math.hypot(x, y, z);
  return length > leastShare * all ? [x / length, y / length, z / length] : null;
}

/** Return a direction after a turn of the light. */
export function turned(direction: Direction, turn: LightTurn): Direction {
  return apply(turnMatrix(turn), direction);
}

/** Return a turn followed by one of some degrees about a unit axis of the world. */
export function turnedAbout(turn: LightTurn, axis: Direction, degrees: number): LightTurn {
  const after = multiply(rotation(axis, degrees), turnMatrix(turn));
  // The last row is (-sin pitch, cos pitch sin roll, cos pitch cos roll).
  const deg = (angle: number): number => (angle * 180) / Math.PI;
  const sine = Math.min(Math.max(-after[2][0], -1), 1);
  const pitchDeg = deg(Math.asin(sine));
  // Looking straight along an axis, yaw and roll are one turn.
  if (Math.abs(sine) > 1 - 1e-9) {
    return { ...turn, pitchDeg, rollDeg: 0, yawDeg: deg(Math.atan2(-after[0][1], after[1][1])) };
  }
  return {
    ...turn,
    pitchDeg,
    rollDeg: deg(Math.atan2(after[2][1], after[2][2])),
    yawDeg: deg(Math.atan2(after[1][0], after[0][0])),
  };
}

function rotation([x, y, z]: Direction, degrees: number): Matrix3 {
  const [c, s] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
  const t = 1 - c;
  return [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
}

function multiply(a: Matrix3, b: Matrix3): Matrix3 {
  const column = (c: 0 | 1 | 2): Direction => apply(a, [b[0][c], b[1][c], b[2][c]]);
  const [x, y, z] = [column(0), column(1), column(2)];
  return [
    [x[0], y[0], z[0]],
    [x[1], y[1], z[1]],
    [x[2], y[2], z[2]],
  ];
}

function apply(matrix: Matrix3, [x, y, z]: Direction): Direction {
  const at = (r: 0 | 1 | 2): number => matrix[r][0] * x + matrix[r][1] * y + matrix[r][2] * z;
  return [at(0), at(1), at(2)];
}

/** Return the turn of a built-in light whose key light is on the left of a viewer at an azimuth. */
export function turnTowards(azimuthDeg: number): LightTurn {
  return { ...initialState.turn, yawDeg: wrapped(Math.round(azimuthDeg)) };
}

/** Return the turn of a light that nobody has turned: `home` for built-in lights, and none for maps as they are. */
export function turnFor(environment: string, home: LightTurn): LightTurn {
  return environment.startsWith("preset:") ? home : initialState.turn;
}

/** Return a change of a state; one to another light brings that light's own turn, unless someone has turned the light. */
export function turnedFor(
  change: Partial<ViewerState>,
  before: Pick<ViewerState, "environment" | "turn">,
  home: LightTurn,
): Partial<ViewerState> {
  if (change.environment === undefined || change.turn !== undefined) return change;
  if (before.turn !== turnFor(before.environment, home)) return change;
  return { ...change, turn: turnFor(change.environment, home) };
}
