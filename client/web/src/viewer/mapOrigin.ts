/** Where the map of a light comes from. */

import type { LoadedBundle } from "../bundle/load.js";
import { MapFault } from "../page/fault.js";
import type { MapOrigin } from "../light/lightWorker.js";
import { isPreset } from "./state.js";
import { fillIn, mapFaults } from "../words/words.js";

/** Return the origin of a light by its name in the state; throws MapFault where there is none. */
export function mapOrigin(
  name: string,
  bundle: Pick<LoadedBundle, "trainedMaps"> | null,
  files: ReadonlyMap<string, Uint8Array<ArrayBuffer>>,
): MapOrigin {
  const [kind, rest] = [name.slice(0, name.indexOf(":")), name.slice(name.indexOf(":") + 1)];
  if (kind === "preset" && isPreset(rest)) return { kind: "preset", name: rest };
  if (kind === "url") return { kind: "url", url: new URL(rest, document.baseURI).href };
  const trained = bundle?.trainedMaps.find((map) => map.name === rest)?.data;
  const data = kind === "trained" ? trained : kind === "file" ? files.get(rest) : undefined;
  if (data === undefined) {
    throw new MapFault("environment.missing", fillIn(mapFaults.noLight, { name }));
  }
  return { kind: "bytes", data };
}
