/** A bundle that cannot be used; codes are those of docs/reference/bundle-format.md. */

import { Fault, toldOf } from "../page/fault.js";

/** A problem with a bundle; `code` starts with "bundle.". */
export class BundleFault extends Fault {
  override readonly name = "BundleFault";
}

/** Return the fault for a part that does not match, which a new export fixes. */
export function exportAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, what, "export the bundle again");
}

/** Return the fault for a file that has come damaged or in part. */
export function fetchAgain(code: string, what: string): BundleFault {
  return new BundleFault(code, what, "fetch the bundle again");
}

/** Return the fault for a bundle that may be meant to do harm. */
export function unsafe(code: string, what: string): BundleFault {
  return new BundleFault(code, what, "do not use this bundle");
}

/** Return an error of reading a bundle as code and message. */
export function bundleTold(error: unknown) {
  const advice = "close other pages, or use a bundle of the lite tier";
  return toldOf(error, "bundle", `there is not enough memory for this bundle; ${advice}`);
}
