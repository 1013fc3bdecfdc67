/** Parts of the state that are put back to their start, each for itself. */

import { initialState, type OrbitPose, type ViewerState } from "./state.js";

export type ResetPart = "light" | "camera" | "material" | "picture";

/**
 * Return the change that puts one part back, the camera to `home`; the chosen environment, and what is compared, stay.
 */
export function resetOf(part: ResetPart, { look }: ViewerState, home: OrbitPose): Partial<ViewerState> {
  const first = initialState;
  switch (part) {
    case "light":
      return { turn: first.turn };
    case "camera":
      return { pose: home };
    case "material":
      return { look: { ...look, edit: first.look.edit } };
    case "picture":
      return { look: { ...first.look, edit: look.edit }, refine: first.refine };
  }
}
