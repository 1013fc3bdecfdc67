/** An environment map that cannot be used; codes are those of `lambent_relight`. */
export class MapFault extends Error {
  override readonly name = "MapFault";

  /** `code` starts with "environment."; `advice` says what to do. */
  constructor(
    readonly code: string,
    what: string,
    readonly advice: string,
  ) {
    super(`${what}; ${advice}`);
  }
}

/** Return an error of preparing a map as code, message and advice. */
export function toldOf(error: unknown): { readonly code: string; readonly message: string } {
  if (error instanceof MapFault) return { code: error.code, message: error.message };
  // Arrays that do not fit are range errors.
  if (error instanceof RangeError) {
    const message = "there is not enough memory for this map; close other pages, or reduce it";
    return { code: "environment.memory", message };
  }
  return { code: "environment.failed", message: error instanceof Error ? error.message : String(error) };
}
