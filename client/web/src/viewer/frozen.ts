/** One state of a viewer, drawn whatever is shown. */

import { interrupted } from "../render/fault.js";
import type { LightTurn, ViewCamera } from "../render/looks.js";
import type { Side, Stage } from "../render/stage.js";
import { turnFor } from "./turning.js";
import type { ViewerState } from "./state.js";

/** Draws a state with changes; returns RGBA bytes, straight alpha, sRGB-encoded, rows from the top. */
export type Frozen = (
  change: Partial<ViewerState>,
  width: number,
  height: number,
  samples: number,
) => Uint8ClampedArray<ArrayBuffer>;

/** Return what draws `state` on a stage; it throws `film.interrupted` when the stage shows something else. */
export function freeze(
  stage: Stage,
  cameraOf: (width: number, height: number, state: ViewerState) => ViewCamera,
  isClosed: () => boolean,
  state: ViewerState,
): Frozen {
  const held = () => [stage.bundle, stage.light("a"), stage.light("b")];
  const first = held();
  const isLost = (): boolean => isClosed() || stage.renderer.getContext().isContextLost();
  return (change, width, height, samples) => {
    if (isLost() || held().some((each, index) => each !== first[index])) throw interrupted();
    const now = { ...state, ...change };
    const { overlay } = stage;
    // A refined picture is of one camera only.
    stage.overlay = null;
    try {
      const pixels = stage.readBytes(cameraOf(width, height, now), sidesOf(now), samples);
      if (isLost()) throw interrupted();
      return pixels;
    } finally {
      stage.overlay = overlay;
    }
  };
}

/**
 * Return the parts of a picture: one, or the two sides of a comparison. A light that nobody has turned stands on each
 * side as it does alone; `home` is the turn of built-in ones.
 */
export function sidesOf(state: ViewerState, home: LightTurn = state.turn): Side[] {
  const { turn, look, compare, split, environment, environmentB } = state;
  const whole: Side = { light: "a", turn, look, method: "baked", from: 0, to: 1 };
  if (compare !== "environment" && compare !== "plain") return [whole];
  const turnB = turn === turnFor(environment, home) ? turnFor(environmentB, home) : turn;
  const other =
    compare === "environment" ? ({ light: "b", turn: turnB } as const) : ({ method: "plain" } as const);
  return [
    { ...whole, to: split },
    { ...whole, ...other, from: split },
  ];
}
