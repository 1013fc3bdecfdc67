/** Errors of drawing. */

import { Fault } from "../page/fault.js";
import { texts } from "../words/words.js";

/** Thrown where the browser cannot draw what the viewer needs. */
export class GraphicsFault extends Error {
  override readonly name = "GraphicsFault";
}

/** Return the fault of a state that can no longer be drawn, in a film or in a refined picture. */
export function interrupted(work: "film" | "refine" = "film"): Fault {
  return new Fault(`${work}.interrupted`, texts.viewer.interrupted);
}
