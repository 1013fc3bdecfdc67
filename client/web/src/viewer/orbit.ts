/** Turning the camera and the light with pointer, touch and keyboard. */

import type { LightTurn } from "../render/looks.js";
import { limits, type OrbitPose, within, wrapped } from "./state.js";

/** The thing being rotated. */
export type Turned = { readonly pose: OrbitPose; readonly turn: LightTurn };

/** The parts of a viewer that an orbit uses. */
export type OrbitHost = {
  readonly element: HTMLElement;
  readonly state: () => Turned;
  readonly change: (next: Partial<Turned>) => void;
  /** Called while fingers or the pointer are down, and when they are lifted. */
  readonly moving: (on: boolean) => void;
};

const degreesPerPixel = 0.35;
const keyDegrees = 5;

/** Return a pose turned by some degrees. */
export function orbited(pose: OrbitPose, azimuth: number, elevation: number): OrbitPose {
  return {
    ...pose,
    azimuthDeg: wrapped(pose.azimuthDeg + azimuth),
    elevationDeg: within(pose.elevationDeg + elevation, limits.elevation, 0),
  };
}

/** Return a pose nearer (factor below 1) or further. */
export function zoomed(pose: OrbitPose, factor: number): OrbitPose {
  return { ...pose, distance: within(pose.distance * factor, limits.distance, pose.distance) };
}

/** Return a pose whose target moved in the picture's plane, in shares of the distance. */
export function panned(pose: OrbitPose, right: number, up: number): OrbitPose {
  const [azimuth, elevation] = [(pose.azimuthDeg * Math.PI) / 180, (pose.elevationDeg * Math.PI) / 180];
  const scale = pose.distance;
  const move = [
    -Math.sin(azimuth) * right - Math.cos(azimuth) * Math.sin(elevation) * up,
    Math.cos(azimuth) * right - Math.sin(azimuth) * Math.sin(elevation) * up,
    Math.cos(elevation) * up,
  ];
  const [x, y, z] = pose.target.map((value, axis) => within(value + scale * move[axis]!, [-5, 5], 0));
  return { ...pose, target: [x!, y!, z!] };
}

/** Listen to an element; returns what stops it. */
export function listenToOrbit(host: OrbitHost): () => void {
  const { element, state, change } = host;
  const stop = new AbortController();
  const options = { signal: stop.signal };
  const pointers = new Map<number, { x: number; y: number }>();

  element.addEventListener(
    "pointerdown",
    (event) => {
      if (event.button > 2) return;
      element.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      host.moving(true);
    },
    options,
  );
  element.addEventListener(
    "pointermove",
    (event) => {
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
        change({ pose: orbited(pose, -degreesPerPixel * dx, degreesPerPixel * dy) });
      }
    },
    options,
  );
  const lift = (event: PointerEvent): void => {
    pointers.delete(event.pointerId);
    if (pointers.size === 0) host.moving(false);
  };
  element.addEventListener("pointerup", lift, options);
  element.addEventListener("pointercancel", lift, options);
  element.addEventListener("contextmenu", (event) => event.preventDefault(), options);
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
      change({ pose: zoomed(state().pose, Math.exp(0.0012 * unit * event.deltaY)) });
    },
    { ...options, passive: false },
  );
  element.addEventListener(
    "keydown",
    (event) => {
      const next = afterKey(event, state());
      if (next === null) return;
      event.preventDefault();
      change(next);
    },
    options,
  );
  return () => stop.abort();
}

type Key = Pick<KeyboardEvent, "key" | "shiftKey" | "altKey" | "ctrlKey" | "metaKey">;

/** Return the change of a key, or null if it has no function here. */
export function afterKey(event: Key, { pose, turn }: Turned): Partial<Turned> | null {
  if (event.altKey || event.ctrlKey || event.metaKey) return null;
  const light = (degrees: number): Partial<Turned> => ({
    turn: { ...turn, yawDeg: wrapped(turn.yawDeg + degrees) },
  });
  switch (event.key) {
    case "ArrowLeft":
      return event.shiftKey ? light(-keyDegrees) : { pose: orbited(pose, -keyDegrees, 0) };
    case "ArrowRight":
      return event.shiftKey ? light(keyDegrees) : { pose: orbited(pose, keyDegrees, 0) };
    case "ArrowUp":
      return { pose: event.shiftKey ? panned(pose, 0, 0.03) : orbited(pose, 0, keyDegrees) };
    case "ArrowDown":
      return { pose: event.shiftKey ? panned(pose, 0, -0.03) : orbited(pose, 0, -keyDegrees) };
    case "[":
      return light(-keyDegrees);
    case "]":
      return light(keyDegrees);
    case "+":
    case "=":
      return { pose: zoomed(pose, 1 / 1.1) };
    case "-":
      return { pose: zoomed(pose, 1.1) };
    default:
      return null;
  }
}
