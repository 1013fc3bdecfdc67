/** A bundle that cannot be used; codes are those of docs/reference/bundle-format.md. */

import { Fault, toldOf } from "../page/fault.js";
import { bundleFaults } from "../words/words.js";

/** A problem with a bundle; `code` starts with "bundle.". */
export class BundleFault extends Fault {
  override readonly name = "BundleFault";
}

/** Return the fault for a part that does not match, which a new export fixes. */
export function exportAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, { what, advice: bundleFaults.exportAgain });
}

/** Return the fault for a file that has come damaged or in part. */
export function fetchAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, { what, advice: bundleFaults.downloadAgain });
}

/** Return the fault for a bundle that may be meant to do harm. */
export function unsafe(code: string, what: string): BundleFault {
  return new BundleFault(code, { what, advice: bundleFaults.unsafe });
}

/** Return an error of reading a bundle as code and message. */
export function bundleTold(error: unknown) {
  return toldOf(error, "bundle", bundleFaults.memory);
}
