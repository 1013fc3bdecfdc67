/** Environment maps from files: decoded, repaired, and converted to latitude-longitude where they are laid out otherwise. */

import type { EnvironmentMap } from "../engine/environmentMap.js";
import { fillIn, mapFaults } from "../words/words.js";
import { readExr } from "./exrInput.js";
import { MapFault } from "../page/fault.js";
import { blankUnused, decidedLayout, type Layout, toLatLong } from "./layouts.js";
import { maxWidth, repaired } from "./prepare.js";
import { readRgbe } from "./rgbe.js";

/** Return the latitude-longitude map of a file, with sentences about what was done to it; throws MapFault. */
export async function openEnvironment(
  data: Uint8Array<ArrayBuffer>,
  maxPixels: number,
  given?: Layout,
): Promise<EnvironmentMap & { readonly notes: readonly string[]; readonly readAs: Layout }> {
  const { stated, ...picture } = await decoded(data, maxPixels);
  const readAs = decidedLayout(picture, stated, given);
  if (readAs === "latlong") return { ...picture, notes: [], readAs };
  const notes: string[] = [];
  const blank = blankUnused(picture, readAs, given !== undefined);
  // Unusable values are replaced before a conversion spreads them.
  const map = toLatLong(repaired(blank, notes), readAs, maxWidth);
  notes.unshift(
    fillIn(mapFaults.converted, { layout: mapFaults.layouts[readAs], to: `${map.width} x ${map.height}` }),
  );
  return { ...map, notes, readAs };
}

async function decoded(
  data: Uint8Array<ArrayBuffer>,
  maxPixels: number,
): Promise<EnvironmentMap & { readonly stated?: Layout }> {
  const [first, second, third, fourth] = data;
  if (first === 0x76 && second === 0x2f && third === 0x31 && fourth === 0x01) return readExr(data, maxPixels);
  if (first === 0x23 && second === 0x3f) return readRgbe(data, maxPixels);
  throw new MapFault("environment.unknown_format", mapFaults.unknownFormat);
}
