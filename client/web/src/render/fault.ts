/** Errors of drawing. */

import type { Problem } from "../words/words.js";

/** Thrown where the browser cannot draw what the viewer needs. */
export class GraphicsFault extends Error {
  override readonly name = "GraphicsFault";

  constructor({ what, advice }: Problem) {
    super(`${what}; ${advice}`);
  }
}
