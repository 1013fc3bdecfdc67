/** Errors of drawing. */

import { deviceFaults } from "../words/deviceFaults.js";

/** Thrown where the browser cannot draw what the viewer needs. */
export class GraphicsFault extends Error {
  override readonly name = "GraphicsFault";

  /** `advice` says what to do. */
  constructor(what: string, advice = deviceFaults.advice) {
    super(`${what}; ${advice}`);
  }
}
