/** Inputs that cannot be used. */

import type { Problem } from "../words/words.js";

/** A problem with an input and what to do about it; `code` is one of those that are documented. */
export class Fault extends Error {
  constructor(
    readonly code: string,
    { what, advice }: Problem,
  ) {
    super(`${what}; ${advice}`);
  }
}

/** Return a reader's error as code and message; codes of others than faults begin with `area`. */
export function toldOf(error: unknown, area: string, outOfMemory: string) {
  if (error instanceof Fault) return { code: error.code, message: error.message };
  // Arrays that do not fit are range errors.
  if (error instanceof RangeError) return { code: `${area}.memory`, message: outOfMemory };
  return { code: `${area}.failed`, message: error instanceof Error ? error.message : String(error) };
}
