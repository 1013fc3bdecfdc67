/** Parts of the state that are put back to their start, each for itself. */

import { turnFor } from "./turning.js";
import { initialState, type ViewerState } from "./state.js";
import type { Viewer } from "./viewer.js";

export type ResetPart = "light" | "camera" | "material" | "picture";

/**
 * Return the change that puts one part back, as it was when the object was opened; the chosen environment, and what is
 * compared, stay.
 */
export function resetOf(
  part: ResetPart,
  { look, environment }: ViewerState,
  { home, homeTurn }: Pick<Viewer, "home" | "homeTurn">,
): Partial<ViewerState> {
  const first = initialState;
  switch (part) {
    case "light":
      return { turn: turnFor(environment, homeTurn) };
    case "camera":
      return { pose: home };
    case "material":
      return { look: { ...look, edit: first.look.edit } };
    case "picture":
      return { look: { ...first.look, edit: look.edit }, refine: first.refine };
  }
}
