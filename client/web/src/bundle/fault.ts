/** A bundle that cannot be used; codes are those of docs/reference/bundle-format.md. */

/** What is wrong, and what to do about it. */
export class BundleFault extends Error {
  override readonly name = "BundleFault";

  /** `code` starts with "bundle."; `advice` tells what to do. */
  constructor(
    readonly code: string,
    what: string,
    readonly advice: string,
  ) {
    super(`${what}; ${advice}`);
  }
}

/** Return the fault of a part that does not fit, of which a new export is the cure. */
export function exportAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, what, "export the bundle again");
}
