/** A bundle that cannot be used; codes are those of docs/reference/bundle-format.md. */

/** A problem with a bundle and what to do about it. */
export class BundleFault extends Error {
  override readonly name = "BundleFault";

  /** `code` starts with "bundle."; `advice` says what to do. */
  constructor(
    readonly code: string,
    what: string,
    readonly advice: string,
  ) {
    super(`${what}; ${advice}`);
  }
}

/** Return the fault for a part that does not match, which a new export fixes. */
export function exportAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, what, "export the bundle again");
}

/** Return a reader's error as code, message and advice. */
export function toldOf(error: unknown): { readonly code: string; readonly message: string } {
  if (error instanceof BundleFault) return { code: error.code, message: error.message };
  // Arrays that do not fit are range errors.
  if (error instanceof RangeError) {
    const advice = "close other pages, or use a bundle of the lite tier";
    return { code: "bundle.memory", message: `there is not enough memory for this bundle; ${advice}` };
  }
  return { code: "bundle.failed", message: error instanceof Error ? error.message : String(error) };
}
