/** Loads bundles in a worker. */

import { startWorker } from "../page/workers.js";
import workerUrl from "./bundleWorker.ts?worker&url";
import { BundleFault } from "./fault.js";
import type { BundleAnswer } from "./bundleWorker.js";
import type { BundleNews, LoadedBundle } from "./load.js";
import { closePictures } from "./pictures.js";
import type { BundleOrigin } from "./source.js";
import { bundleFaults } from "../words/bundleFaults.js";

/** Read a bundle in a worker that exits afterwards; `signal` aborts it. Throws BundleFault. */
export function loadInWorker(
  origin: BundleOrigin,
  tell: (news: BundleNews) => void,
  signal: AbortSignal,
): Promise<LoadedBundle> {
  const worker = startWorker(workerUrl);
  return new Promise<LoadedBundle>((resolve, reject) => {
    const end = (): void => worker.terminate();
    signal.addEventListener("abort", () => {
      end();
      reject(signal.reason);
    });
    worker.onerror = (event) => {
      end();
      reject(new BundleFault("bundle.failed", event.message || bundleFaults.reader, bundleFaults.reload));
    };
    worker.onmessage = ({ data }: MessageEvent<BundleAnswer>) => {
      if (data.kind === "loaded") {
        end();
        resolve(data.bundle);
      } else if (data.kind === "failed") {
        end();
        reject(Object.assign(new BundleFault(data.code, "", ""), { message: data.message }));
      } else tell(data);
    };
    worker.postMessage(origin);
  });
}

/** Read a bundle while `other` work goes on, of which it is nothing without; see `loadInWorker`. */
export async function loadBeside(
  other: Promise<void>,
  ...[origin, tell, signal]: Parameters<typeof loadInWorker>
): Promise<LoadedBundle> {
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
