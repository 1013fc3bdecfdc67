/** One state of a viewer, drawn whatever is shown. */

import { Fault } from "../page/fault.js";
import type { Side } from "../render/stage.js";
import type { ViewerState } from "./state.js";

/** Draws a state with changes; returns RGBA bytes, straight alpha, sRGB-encoded, rows from the top. */
export type Frozen = (
  change: Partial<ViewerState>,
  width: number,
  height: number,
  samples: number,
) => Uint8ClampedArray<ArrayBuffer>;

/** Return the fault of a state that can no longer be drawn. */
export function interrupted(): Fault {
  return new Fault(
    "film.interrupted",
    "another bundle or light was shown, or the graphics card was lost, before the film was complete",
    "make the film again",
  );
}

/** Return the parts of a picture: one, or the two sides of a comparison. */
export function sidesOf({ turn, look, compare, split }: ViewerState): Side[] {
  const whole: Side = { light: "a", turn, look, method: "baked", from: 0, to: 1 };
  if (compare !== "environment" && compare !== "plain") return [whole];
  const other = compare === "environment" ? ({ light: "b" } as const) : ({ method: "plain" } as const);
  return [
    { ...whole, to: split },
    { ...whole, ...other, from: split },
  ];
}
