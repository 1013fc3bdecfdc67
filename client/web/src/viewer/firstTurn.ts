/** The turn of a light that nobody has turned: towards the first view, and slowly around it until someone does something. */

import { type ViewerState, wrapped } from "./state.js";
import type { Viewer } from "./viewer.js";

const degreesPerSecond = 10;
/** The light stops after that many turns, to save power. */
const mostTurns = 3;
/** Where frames take longer than this the turn is not smooth, and stops. */
const longestFrameMs = 90;
const judgedFrames = 8;

/** Return whether a part of an element is in the window. */
export function isInWindow(element: Element): boolean {
  const { top, bottom } = element.getBoundingClientRect();
  return bottom >= 0 && top <= innerHeight;
}

/** Return whether the mean of the last frames is too long for a motion. */
export function isSlow(frameMs: readonly number[]): boolean {
  const last = frameMs.slice(-judgedFrames);
  return (
    last.length === judgedFrames && last.reduce((sum, ms) => sum + ms, 0) > judgedFrames * longestFrameMs
  );
}

/**
 * Turn the light of a viewer slowly about +z from when a bundle is there until the first input, a change by anyone
 * else, or `signal`. A light that someone has turned, and one beside another, stays; and all do where the system asks
 * for reduced motion. `moving` is called at the beginning and the end.
 */
export function turnUntilInput(
  viewer: Viewer,
  host: HTMLElement,
  moving: (on: boolean) => void,
  signal: AbortSignal,
): void {
  let frame = 0;
  let lastAt = 0;
  let turnedDeg = 0;
  let frames: number[] = [];
  let own: ViewerState | null = null;
  const end = (): void => {
    if (frame === 0) return;
    cancelAnimationFrame(frame);
    frame = 0;
    // Whole degrees are enough for people.
    if (viewer.state.turn === viewer.homeTurn) show(Math.round(viewer.homeTurn.yawDeg));
    moving(false);
  };
  const show = (yawDeg: number): void => {
    viewer.homeTurn = { ...viewer.homeTurn, yawDeg: wrapped(yawDeg) };
    void viewer.update({ turn: viewer.homeTurn });
    own = viewer.state;
  };
  const step = (now: number): void => {
    // A change whose light is still being fetched.
    if (viewer.state !== own) {
      end();
      return;
    }
    const elapsedMs = now - lastAt;
    lastAt = now;
    // A page in the background has no frames; what it missed is not made up for.
    if (elapsedMs < 1000) frames = [...frames.slice(1 - judgedFrames), elapsedMs];
    const degrees = (degreesPerSecond * Math.min(elapsedMs, 100)) / 1000;
    turnedDeg += degrees;
    if (turnedDeg > mostTurns * 360 || isSlow(frames)) {
      end();
      return;
    }
    frame = requestAnimationFrame(step);
    if (!isInWindow(host)) return;
    show(viewer.homeTurn.yawDeg + degrees);
  };
  const begin = (): void => {
    const { state, homeTurn } = viewer;
    const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const isOurs = state.turn === homeTurn && state.compare === "off" && !state.refine;
    if (frame !== 0 || isStill || !isOurs) return;
    frames = [];
    turnedDeg = 0;
    own = state;
    moving(true);
    frame = requestAnimationFrame((now) => {
      lastAt = now;
      frame = requestAnimationFrame(step);
    });
  };
  for (const input of ["pointerdown", "keydown", "wheel", "dragenter", "click", "input"] as const) {
    // Before what the input does.
    host.addEventListener(input, end, { signal, capture: true, passive: true });
  }
  const followed = (): void => {
    if (viewer.state !== own) end();
  };
  const stops = [viewer.on("load", begin), viewer.on("change", followed)];
  signal.addEventListener("abort", () => {
    cancelAnimationFrame(frame);
    for (const stop of stops) stop();
  });
}
