/** Bundles and environment maps that cannot be used. */

import { bundleFaults, fillIn, mapFaults } from "../words/words.js";

/** A problem with an input; its message is "what; advice", `code` is one of those that are documented. */
export class Fault extends Error {
  constructor(
    readonly code: string,
    message: string,
  ) {
    super(message);
  }
}

/** Return the message of an error. */
export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

/** Return a reader's error as code and message; codes of errors that are not faults begin with `area`. */
export function toldOf(error: unknown, area: string, outOfMemory: string) {
  if (error instanceof Fault) return { code: error.code, message: error.message };
  // Arrays that do not fit are range errors.
  if (error instanceof RangeError) return { code: `${area}.memory`, message: outOfMemory };
  return { code: `${area}.failed`, message: messageOf(error) };
}

/** A bundle that cannot be used; codes are those of docs/reference/bundle-format.md. */
export class BundleFault extends Fault {
  override readonly name = "BundleFault";
}

/** Return the fault for a part that does not match, which a new export fixes. */
export function exportAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, `${what}; ${bundleFaults.exportAgain}`);
}

/** Return the fault for a file that has come damaged or in part. */
export function fetchAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, `${what}; ${bundleFaults.downloadAgain}`);
}

/** Return the fault for a bundle that may be meant to do harm. */
export function unsafe(code: string, what: string): BundleFault {
  return new BundleFault(code, `${what}; ${bundleFaults.unsafe}`);
}

/** An environment map that cannot be used; codes are those of `lambent_relight`. */
export class MapFault extends Fault {
  override readonly name = "MapFault";
}

/** Return the fault of a map that has more pixels than can be read. */
export function tooLarge(width: number, height: number, maxPixels: number): MapFault {
  return new MapFault(
    "environment.too_large",
    fillIn(mapFaults.tooLarge, { width, height, most: maxPixels }),
  );
}
