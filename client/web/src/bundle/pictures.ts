/** The pictures of a bundle in memory. */

import type { LoadedBundle } from "./load.js";

/** Give back the memory of a bundle's pictures: browsers do that late by themselves, and seldom know how much it is. */
export function closePictures({ maps, unseen }: Pick<LoadedBundle, "maps" | "unseen">): void {
  for (const each of [maps.albedo, maps.packed, maps.normal, unseen]) each?.close();
}
