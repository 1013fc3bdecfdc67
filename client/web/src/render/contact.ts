/**
 * Where an object stood: the lowest points of what photographs show of it. What none shows, such as the underside, is
 * invented, and may bulge through the ground.
 */

import type { LoadedBundle } from "../bundle/load.js";
import type { AtlasMesh } from "../bundle/mesh.js";
import { deviceFaults } from "../words/words.js";

/** Share of the seen vertices that may lie under the ground: stray ones, and thickness that fits are off by. */
const below = 0.005;

/** Says whether a photograph shows a place of the atlas. */
export type Seen = (u: number, v: number) => boolean;

/** Return the height of the ground; `seen` is null where nothing is known to be hidden. */
export function contactHeight({ positionsXyz, uv }: AtlasMesh, seen: Seen | null): number {
  const heights: number[] = [];
  for (let vertex = 0; 3 * vertex < positionsXyz.length; vertex++) {
    if (seen?.(uv[2 * vertex]!, uv[2 * vertex + 1]!) ?? true) heights.push(positionsXyz[3 * vertex + 2]!);
  }
  if (heights.length === 0) return contactHeight({ positionsXyz, uv } as AtlasMesh, null);
  const sorted = Float64Array.from(heights).sort();
  return sorted[Math.floor(below * sorted.length)]!;
}

const heights = new WeakMap<LoadedBundle, number>();

/** Return the height of the ground under a bundle's object, which is found once. */
export function groundHeight(bundle: LoadedBundle): number {
  const known = heights.get(bundle);
  if (known !== undefined) return known;
  const { mesh, unseen } = bundle;
  const height = contactHeight(mesh, unseen === null ? null : seenBy(unseen));
  heights.set(bundle, height);
  unseen?.close();
  return height;
}

/** Return a reader of the mask mesh/unseen.png, white where no photograph shows the surface. */
export function seenBy(unseen: ImageBitmap): Seen {
  const { width, height } = unseen;
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  if (context === null) throw new Error(deviceFaults.noCanvas);
  context.drawImage(unseen, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  const inside = (share: number, side: number): number => Math.min(Math.floor(share * side), side - 1);
  return (u, v) => data[4 * (inside(v, height) * width + inside(u, width))]! < 128;
}
