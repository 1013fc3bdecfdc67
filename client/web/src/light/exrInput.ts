/**
 * OpenEXR maps, with the checks of `lambent_core.exr`: whole lines of half floats, as most programs write them,
 * are read here with the browser's own decompression, in half of three's time and with the checksums compared; everything
 * else is decoded by three.
 */

import { FloatType } from "three";
import { EXRLoader } from "three/addons/loaders/EXRLoader.js";
import type { EnvironmentMap } from "../engine/environmentMap.js";
import { checkHeader, damaged, type Shown, shownOf, statedBy, statedLayout } from "./exrHeader.js";
import { halfLinesOf, readHalfLines } from "./exrLines.js";
import type { Layout } from "./layouts.js";

/** Return the linear Rec. 709 picture, row 0 at the top, and the layout that it states; throws MapFault. */
export async function readExr(
  data: Uint8Array<ArrayBuffer>,
  maxPixels: number,
): Promise<EnvironmentMap & { readonly stated?: Layout }> {
  const stated = statedBy(data, maxPixels);
  const shown = checkHeader(stated);
  const layout = statedLayout(stated);
  const lines = halfLinesOf(stated, shown);
  const storedRgb =
    lines === null ? decodedByThree(data, stated.part, shown) : await readHalfLines(data, lines);
  return { ...shownOf(storedRgb, shown), ...(layout && { stated: layout }) };
}

/** Return the stored picture of any kind of file, row 0 at the top, as three decodes it. */
export function decodedByThree(data: Uint8Array<ArrayBuffer>, part: number, { stored }: Shown): Float32Array {
  // The decoder reads texts until a zero comes: there is one behind the file.
  const padded = new Uint8Array(data.length + 64);
  padded.set(data);
  let decoded: { readonly width: number; readonly height: number; readonly data: Float32Array };
  try {
    decoded = new EXRLoader().setDataType(FloatType).setPart(part).parse(padded.buffer) as typeof decoded;
  } catch {
    throw damaged();
  }
  const { width, height } = stored;
  if (decoded.width !== width || decoded.height !== height) throw damaged();
  const storedRgb = new Float32Array(3 * width * height);
  for (let row = 0; row < height; row++) {
    // The decoder's first row is the lowest.
    let source = 4 * (height - 1 - row) * width;
    for (let target = 3 * row * width; target < 3 * (row + 1) * width; target += 3, source += 4) {
      storedRgb[target] = decoded.data[source]!;
      storedRgb[target + 1] = decoded.data[source + 1]!;
      storedRgb[target + 2] = decoded.data[source + 2]!;
    }
  }
  return storedRgb;
}
