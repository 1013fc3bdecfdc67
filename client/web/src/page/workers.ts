/** Starts workers, also for pages of other origins than our scripts. */

import { locale } from "../words/words.js";

const begun = new Map<string, string>();

/**
 * Start the module at `address` as a worker. Browsers refuse workers whose script is of another origin than the page;
 * there a script of the page's own, a blob, imports it, which needs `worker-src` with `blob:` and our origin in a strict policy of that page.
 */
export function startWorker(address: string): Worker {
  return new Worker(workerScript(new URL(address, location.href), location.origin), {
    type: "module",
    // What it says is in the language of the page.
    name: locale,
  });
}

/** Return the address to start: that of the module, or of a script that imports it. */
export function workerScript(address: URL, origin: string): string {
  if (address.origin === origin) return address.href;
  const known = begun.get(address.href);
  if (known !== undefined) return known;
  const text = `import ${JSON.stringify(address.href)};`;
  const made = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  begun.set(address.href, made);
  return made;
}
