/** The plan of a film: size, frames, and the state of the viewer at each frame. */

import { Fault } from "../page/fault.js";
import { type ViewerState, wrapped } from "../viewer/state.js";
import { fillIn, texts } from "../words/words.js";

/** What makes one turn in a film: the camera, the light, or both in opposite directions. */
export const motions = ["turntable", "light", "both"] as const;
export type Motion = (typeof motions)[number];

export const filmFormats = ["mp4", "webm"] as const;
export type FilmFormat = (typeof filmFormats)[number];

/** A film to make. */
export type FilmPlan = {
  readonly motion: Motion;
  readonly format: FilmFormat;
  /** Pixels; even numbers, because the colours of films have half their size. */
  readonly width: number;
  readonly height: number;
  readonly seconds: number;
  readonly framesPerSecond: number;
  /** Whether the first frame follows the last one; otherwise the last frame equals the first. */
  readonly loop: boolean;
};

export const defaultPlan: FilmPlan = {
  motion: "turntable",
  format: "mp4",
  width: 1920,
  height: 1080,
  seconds: 4,
  framesPerSecond: 30,
  loop: true,
};

export const filmLimits = {
  side: [16, 4096],
  seconds: [0.1, 60],
  framesPerSecond: [1, 120],
} as const;

/** Return how many frames a film has. */
export function frameCount({ seconds, framesPerSecond }: FilmPlan): number {
  return Math.max(Math.round(seconds * framesPerSecond), 1);
}

/** Return a whole plan; throws the fault `film.plan` where a film of it cannot be made. */
export function planned(asked: Partial<FilmPlan>): FilmPlan {
  const given = Object.entries(asked).filter(([name, value]) => name in defaultPlan && value !== undefined);
  const plan: FilmPlan = { ...defaultPlan, ...Object.fromEntries(given) };
  const inside = (value: number, [least, most]: readonly [number, number]): boolean =>
    value >= least && value <= most;
  const refuse = (problem: string): never => {
    throw new Fault("film.plan", problem);
  };
  if (!motions.includes(plan.motion)) {
    refuse(fillIn(texts.film.badMotion, { motion: plan.motion, all: motions.join(", ") }));
  }
  if (!filmFormats.includes(plan.format)) {
    refuse(fillIn(texts.film.badFormat, { format: plan.format, all: filmFormats.join(", ") }));
  }
  for (const side of [plan.width, plan.height]) {
    if (!inside(side, filmLimits.side) || side % 2 !== 0) {
      refuse(fillIn(texts.film.badSize, { width: plan.width, height: plan.height }));
    }
  }
  if (!inside(plan.seconds, filmLimits.seconds)) {
    refuse(fillIn(texts.film.badSeconds, { seconds: plan.seconds }));
  }
  if (!inside(plan.framesPerSecond, filmLimits.framesPerSecond)) {
    refuse(fillIn(texts.film.badRate, { rate: plan.framesPerSecond }));
  }
  return plan;
}

/** Return the part of the turn before a frame, from 0 to 1. */
export function momentAt(plan: FilmPlan, frame: number): number {
  const count = frameCount(plan);
  return plan.loop ? frame / count : frame / Math.max(count - 1, 1);
}

/** Return what changes in the state by a moment of a film, from 0 to 1. */
export function momentOf(state: ViewerState, motion: Motion, moment: number): Partial<ViewerState> {
  const turned = (degrees: number, turns: number): number => wrapped(degrees + 360 * turns * moment);
  const pose = { ...state.pose, azimuthDeg: turned(state.pose.azimuthDeg, 1) };
  const light = (turns: number) => ({ ...state.turn, yawDeg: turned(state.turn.yawDeg, turns) });
  if (motion === "turntable") return { pose };
  return motion === "light" ? { turn: light(1) } : { pose, turn: light(-1) };
}
