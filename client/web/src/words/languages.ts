/** The languages that are shipped, and which of them is spoken. */

import type { BundleFaults, DeviceFaults, MapFaults, Texts } from "./en.js";

/** All that is said in one language. */
export type Catalogue = {
  readonly texts: Texts;
  readonly bundleFaults: BundleFaults;
  readonly mapFaults: MapFaults;
  readonly deviceFaults: DeviceFaults;
};

/** Languages besides English, each with what fetches its catalogue. */
const others: Readonly<Record<string, () => Promise<Catalogue>>> = {
  de: () => import("./de.js"),
};

export const languages: readonly string[] = ["en", ...Object.keys(others)];

/** Return the language of a tag such as "de-AT". */
export function languageOf(tag: string): string {
  return tag.split("-")[0]!.toLowerCase();
}

/** Return the first of the wanted tags whose language is shipped, else "en". */
export function chosen(wanted: readonly string[]): string {
  return wanted.flatMap(canonical).find((tag) => languages.includes(languageOf(tag))) ?? "en";
}

/** Return a tag as it is written, or nothing where it is none: what a page says of itself may be anything. */
function canonical(tag: string): string[] {
  try {
    return Intl.getCanonicalLocales(tag.trim());
  } catch {
    return [];
  }
}

const listeners = new Set<(catalogue: Catalogue | null) => void>();
let spoken: Catalogue | null = null;

/** Call `take` with the catalogue that is spoken from now on, null for English, which is not fetched. */
export function onSpeech(take: (catalogue: Catalogue | null) => void): void {
  listeners.add(take);
  if (spoken !== null) take(spoken);
}

/** Whether a tag's language has to be fetched. */
export function isFetched(tag: string): boolean {
  return Object.hasOwn(others, languageOf(tag));
}

/** Fetch the catalogue of a tag's language and speak it from then on; English where it cannot be fetched. */
export async function speakAs(tag: string): Promise<void> {
  spoken = isFetched(tag) ? await others[languageOf(tag)]!().catch(() => null) : null;
  for (const take of listeners) take(spoken);
}

/** Resolves when a worker knows its language, of which the page has given it the name. */
export function workerSpeaks(): Promise<void> {
  return speakAs(self.name);
}
