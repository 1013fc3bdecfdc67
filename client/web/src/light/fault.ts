/** An environment map that cannot be used; codes are those of `lambent_relight`. */

import { Fault, toldOf } from "../page/fault.js";
import { fillIn, mapFaults } from "../words/words.js";

/** A problem with a map; `code` starts with "environment.". */
export class MapFault extends Fault {
  override readonly name = "MapFault";
}

/** Return an error of preparing a map as code and message. */
export function mapTold(error: unknown) {
  return toldOf(error, "environment", mapFaults.memory);
}

/** Return the fault of a map that has more pixels than can be read. */
export function tooLarge(width: number, height: number, maxPixels: number): MapFault {
  return new MapFault(
    "environment.too_large",
    fillIn(mapFaults.tooLarge, { width, height, most: maxPixels }),
  );
}
