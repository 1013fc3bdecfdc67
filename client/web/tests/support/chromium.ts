/** Starts the system's Chromium for tests in a real browser; WebGL2 in software. */

import { accessSync, constants } from "node:fs";
import { delimiter, join, resolve } from "node:path";
import { type Browser, chromium } from "playwright-core";

const flags = [
  "--headless",
  "--no-sandbox",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--disable-background-networking",
  // The pages speak the language of the browser, and tests look for English texts.
  "--lang=en-US",
  "--accept-lang=en-US",
];

/** Pages are set in one font on all machines, so that they have one layout. */
const fonts = resolve(import.meta.dirname, "fonts.conf");

/** Return the browser's path; throws where there is none. */
export function chromiumPath(): string {
  for (const folder of (process.env.PATH ?? "").split(delimiter)) {
    for (const name of ["chromium", "chromium-browser"]) {
      const path = join(folder, name);
      try {
        accessSync(path, constants.X_OK);
        return path;
      } catch {
        // Look on.
      }
    }
  }
  throw new Error("no Chromium in PATH; on Debian: apt-get install chromium");
}

/** Start a browser; `more` are further flags, such as those of WebGPU. */
export async function startChromium(more: readonly string[] = []): Promise<Browser> {
  return chromium.launch({
    executablePath: chromiumPath(),
    args: [...flags, ...more],
    env: { ...process.env, FONTCONFIG_FILE: fonts } as Record<string, string>,
  });
}

let shared: Promise<Browser> | null = null;

/** Return the browser that all tests of this process share; it ends with the process. Close the pages that you open. */
export function sharedChromium(): Promise<Browser> {
  shared ??= startChromium();
  return shared;
}

/** Close all pages of a browser. */
export async function closePages(browser: Browser): Promise<void> {
  await Promise.all(browser.contexts().map((context) => context.close()));
}
