/**
 * OpenEXR maps, with the checks of `lambent_core.exr`: whole lines of half floats, as most programs write them,
 * are read here with the browser's own decompression; everything else is decoded by three.
 */

import { FloatType } from "three";
import { EXRLoader } from "three/addons/loaders/EXRLoader.js";
import type { EnvironmentMap } from "../engine/environmentMap.js";
import {
  checkChannels,
  checkHeader,
  damaged,
  type Header,
  shownOf,
  statedBy,
  statedLayout,
} from "./exrHeader.js";
import { halfLinesOf, readHalfLines } from "./exrLines.js";
import type { Layout } from "./layouts.js";

type Decoded = {
  readonly header: Header;
  readonly width: number;
  readonly height: number;
  readonly data: Float32Array;
};

/** Return the linear Rec. 709 picture, row 0 at the top, and the layout that it states; throws MapFault. */
export async function readExr(
  data: Uint8Array<ArrayBuffer>,
  maxPixels: number,
): Promise<EnvironmentMap & { readonly stated?: Layout }> {
  const stated = statedBy(data, maxPixels);
  checkChannels(stated);
  const layout = statedLayout(stated);
  const lines = halfLinesOf(stated);
  if (lines === null) return { ...decodedByThree(data, stated.part), ...(layout && { stated: layout }) };
  const shown = checkHeader(lines.header, lines.width, lines.height);
  return { ...shownOf(await readHalfLines(data, lines), shown), ...(layout && { stated: layout }) };
}

/** Return the picture decoded by three, for any kind of file. */
export function decodedByThree(data: Uint8Array<ArrayBuffer>, part = 0): EnvironmentMap {
  let decoded: Decoded;
  try {
    // The decoder reads texts until a zero comes: there is one behind the file.
    const padded = new Uint8Array(data.length + 64);
    padded.set(data);
    decoded = new EXRLoader().setDataType(FloatType).setPart(part).parse(padded.buffer) as unknown as Decoded;
  } catch {
    throw damaged();
  }
  const { header, width, height } = decoded;
  const shown = checkHeader(header, width, height);
  const radianceRgb = new Float32Array(3 * width * height);
  for (let row = 0; row < height; row++) {
    // The decoder's first row is the lowest.
    let source = 4 * (height - 1 - row) * width;
    for (let target = 3 * row * width; target < 3 * (row + 1) * width; target += 3, source += 4) {
      radianceRgb[target] = decoded.data[source]!;
      radianceRgb[target + 1] = decoded.data[source + 1]!;
      radianceRgb[target + 2] = decoded.data[source + 2]!;
    }
  }
  return shownOf({ height, width, radianceRgb }, shown);
}
