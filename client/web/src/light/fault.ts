/** An environment map that cannot be used; codes are those of `lambent_relight`. */
export class MapFault extends Error {
  override readonly name = "MapFault";

  /** `code` starts with "environment."; `advice` tells what to do. */
  constructor(
    readonly code: string,
    what: string,
    readonly advice: string,
  ) {
    super(`${what}; ${advice}`);
  }
}
