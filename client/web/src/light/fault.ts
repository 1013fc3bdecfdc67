/** An environment map that cannot be used; codes are those of `lambent_relight`. */

import { Fault, toldOf } from "../page/fault.js";

/** A problem with a map; `code` starts with "environment.". */
export class MapFault extends Fault {
  override readonly name = "MapFault";
}

/** Return an error of preparing a map as code and message. */
export function mapTold(error: unknown) {
  const outOfMemory = "there is not enough memory for this map; close other pages, or reduce it";
  return toldOf(error, "environment", outOfMemory);
}

/** Return the fault of a map that has more pixels than can be read. */
export function tooLarge(width: number, height: number, maxPixels: number): MapFault {
  return new MapFault(
    "environment.too_large",
    `the map has ${width} x ${height} pixels, the limit is ${maxPixels}`,
    "reduce the map (8192 x 4096 is plenty for lighting)",
  );
}
