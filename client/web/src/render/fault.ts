/** Errors of drawing. */

/** Thrown where the browser cannot draw what the viewer needs. */
export class GraphicsFault extends Error {
  override readonly name = "GraphicsFault";

  /** `advice` says what to do. */
  constructor(
    what: string,
    advice = "update the browser, switch hardware acceleration on, or use another device",
  ) {
    super(`${what}; ${advice}`);
  }
}
