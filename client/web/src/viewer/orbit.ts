/** Turning the camera and the light with pointer, touch and keyboard. */

import type { LightTurn } from "../render/looks.js";
import { axesOf } from "./camera.js";
import { listening } from "./fields.js";
import { limits, type OrbitPose, within, wrapped } from "./state.js";

/** The thing being rotated. */
export type Turned = { readonly pose: OrbitPose; readonly turn: LightTurn };

/** The parts of a viewer that an orbit uses. */
export type OrbitHost = {
  readonly element: HTMLElement;
  readonly state: () => Turned;
  readonly change: (next: Partial<Turned>) => void;
  /** The elevations to look from, degrees. */
  readonly elevation: () => Range;
  /** Called while fingers or the pointer are down, and when they are lifted. */
  readonly moving: (on: boolean) => void;
};

const degreesPerPixel = 0.35;
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

/** Listen to an element until `signal`. */
export function listenToOrbit(
  { element, state, change, moving, elevation }: OrbitHost,
  signal: AbortSignal,
): void {
  const on = listening(signal);
  const pointers = new Map<number, { x: number; y: number }>();

  on(element, "pointerdown", (event) => {
    if (event.button > 2) return;
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    moving(true);
  });
  on(element, "pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (before === undefined) return;
    const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
    const gap = (): number => {
      const [a, b] = [...pointers.values()];
      return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
    };
    const gapBefore = gap();
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const { pose, turn } = state();
    const share = 1 / Math.max(element.clientHeight, 1);
    if (pointers.size > 1) {
      const closer = gapBefore > 0 && gap() > 0 ? zoomed(pose, gapBefore / gap()) : pose;
      change({ pose: panned(closer, -0.3 * dx * share, 0.3 * dy * share) });
    } else if (event.shiftKey) {
      change({ turn: { ...turn, yawDeg: wrapped(turn.yawDeg + degreesPerPixel * dx) } });
    } else if (event.ctrlKey || (event.buttons & 6) !== 0) {
      change({ pose: panned(pose, -0.6 * dx * share, 0.6 * dy * share) });
    } else {
      change({ pose: orbited(pose, -degreesPerPixel * dx, degreesPerPixel * dy, elevation()) });
    }
  });
  for (const lifted of ["pointerup", "pointercancel"] as const) {
    on(element, lifted, (event) => {
      pointers.delete(event.pointerId);
      if (pointers.size === 0) moving(false);
    });
  }
  on(element, "contextmenu", (event) => event.preventDefault());
  const wheel = (event: WheelEvent): void => {
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    change({ pose: zoomed(state().pose, Math.exp(0.0012 * unit * event.deltaY)) });
  };
  element.addEventListener("wheel", wheel, { signal, passive: false });
  on(element, "keydown", (event) => {
    const next = afterKey(event, state(), elevation());
    if (next === null) return;
    event.preventDefault();
    change(next);
  });
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
