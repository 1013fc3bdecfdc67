/** Reads bundles in a worker: fetching, digests and packing do not block the main thread. */

import { transferablesOf } from "../page/buffers.js";
import { toldOf } from "../page/fault.js";
import { type BundleNews, type LoadedBundle, loadBundle } from "./load.js";
import type { BundleOrigin } from "./source.js";
import type { FinerTables } from "./transport.js";
import { workerSpeaks } from "../words/languages.js";
import { bundleFaults } from "../words/words.js";

/** Messages of the worker; the last one is "failed", "finer", or "loaded" where there is no `more`. */
export type BundleAnswer =
  | BundleNews
  | { readonly kind: "loaded"; readonly bundle: LoadedBundle; readonly more: boolean }
  | { readonly kind: "finer"; readonly tables: FinerTables }
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
    const later: (() => Promise<FinerTables>)[] = [];
    const bundle = await loadBundle(
      data,
      (news) => answer(news),
      decode,
      (finer) => later.push(finer),
    );
    answer({ kind: "loaded", bundle, more: later.length > 0 }, transferablesOf(bundle));
    for (const finer of later) {
      const tables = await finer();
      answer({ kind: "finer", tables }, transferablesOf(tables));
    }
  } catch (error) {
    answer({ kind: "failed", ...toldOf(error, "bundle", bundleFaults.memory) });
  }
};
