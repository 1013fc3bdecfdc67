/** Fast caches that were adapted to one light: Python's `refined` may take their radiance, refining here does not. */

import type { BundleManifest } from "../contract/lambent_proto/v1/bundle_pb.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** Return the notes about a bundle's adapted caches; empty if it has none. */
export function adaptedNote({ graphs, trainLights }: Pick<BundleManifest, "graphs" | "trainLights">): string {
  const adapted = graphs.filter(({ name, light }) => name === "fast_cache" && !trainLights.includes(light));
  if (adapted.length === 0) return "";
  const names = adapted.map(({ light }) => light.slice(0, 40)).join(", ");
  return fillIn(bundleFaults.adapted, { lights: names });
}
