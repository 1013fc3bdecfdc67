/** Reads bundles in a worker: fetching, digests and packing do not block the main thread. */

import { transferablesOf } from "../page/buffers.js";
import { bundleTold } from "./fault.js";
import { type BundleNews, type LoadedBundle, loadBundle } from "./load.js";
import type { BundleOrigin } from "./source.js";
import { workerSpeaks } from "../words/languages.js";

/** Messages of the worker; the last one is "loaded" or "failed". */
export type BundleAnswer =
  | BundleNews
  | { readonly kind: "loaded"; readonly bundle: LoadedBundle }
  | { readonly kind: "failed"; readonly code: string; readonly message: string };

const answer = (message: BundleAnswer, transfer: Transferable[] = []): void => {
  self.postMessage(message, { transfer });
};

// Levels are data: no colour profile, and no product with an alpha that is not there.
const decode = (png: Uint8Array<ArrayBuffer>): Promise<ImageBitmap> =>
  createImageBitmap(new Blob([png], { type: "image/png" }), {
    colorSpaceConversion: "none",
    premultiplyAlpha: "none",
  });

self.onmessage = async ({ data }: MessageEvent<BundleOrigin>) => {
  await workerSpeaks();
  try {
    const bundle = await loadBundle(data, (news) => answer(news), decode);
    answer({ kind: "loaded", bundle }, transferablesOf(bundle));
  } catch (error) {
    answer({ kind: "failed", ...bundleTold(error) });
  }
};
