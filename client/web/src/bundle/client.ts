/** Loads bundles in a worker. */

import { startWorker } from "../page/workers.js";
import workerUrl from "./bundleWorker.ts?worker&url";
import { BundleFault } from "../page/fault.js";
import type { BundleAnswer } from "./bundleWorker.js";
import { type BundleNews, closePictures, type ShownBundle } from "./load.js";
import type { BundleOrigin } from "./source.js";
import type { FinerTables } from "./transport.js";
import { bundleFaults } from "../words/words.js";

/** Read a bundle in a worker that exits when all is there; `signal` aborts it. Throws BundleFault. */
export function loadInWorker(
  origin: BundleOrigin,
  tell: (news: BundleNews) => void,
  signal: AbortSignal,
): Promise<ShownBundle> {
  const worker = startWorker(workerUrl);
  let resolveFiner = (_: FinerTables): void => {};
  let rejectFiner = (_: unknown): void => {};
  const finer = new Promise<FinerTables>((resolve, reject) => {
    [resolveFiner, rejectFiner] = [resolve, reject];
  });
  finer.catch(() => {}); // Told to whoever waits for it.
  return new Promise<ShownBundle>((resolve, reject) => {
    const fail = (reason: unknown): void => {
      worker.terminate();
      reject(reason);
      rejectFiner(reason);
    };
    signal.addEventListener("abort", () => fail(signal.reason));
    worker.onerror = (event) => {
      const what = event.message || bundleFaults.reader;
      fail(new BundleFault("bundle.failed", `${what}; ${bundleFaults.reload}`));
    };
    worker.onmessage = ({ data }: MessageEvent<BundleAnswer>) => {
      if (data.kind === "loaded") {
        if (!data.more) worker.terminate();
        resolve({ ...data.bundle, finer: data.more ? finer : null });
      } else if (data.kind === "finer") {
        worker.terminate();
        resolveFiner(data.tables);
      } else if (data.kind === "failed") {
        fail(new BundleFault(data.code, data.message));
      } else tell(data);
    };
    worker.postMessage(origin);
  });
}

/** Read a bundle during `other` work, without which it is useless; see `loadInWorker`. */
export async function loadBeside(
  other: Promise<void>,
  ...[origin, tell, signal]: Parameters<typeof loadInWorker>
): Promise<ShownBundle> {
  const reading = loadInWorker(origin, tell, signal);
  reading.catch(() => {}); // Told below.
  try {
    await other;
  } catch (error) {
    reading.then(closePictures, () => {});
    throw error;
  }
  const bundle = await reading;
  if (signal.aborted) closePictures(bundle);
  signal.throwIfAborted();
  return bundle;
}
