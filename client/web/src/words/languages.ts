/** The languages that are shipped, and the one in use. */

import type english from "./en.json";

/** All texts of one language. */
export type Catalogue = typeof english;

/** Languages besides English, each with what fetches its catalogue. */
const others: Readonly<Record<string, () => Promise<Catalogue>>> = {
  de: () => import("./de.json"),
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

/** Return a tag in its canonical form; nothing for text that is not a tag, which a page's `lang` may be. */
function canonical(tag: string): string[] {
  try {
    return Intl.getCanonicalLocales(tag.trim());
  } catch {
    return [];
  }
}

/** The language in use, and its catalogue; null for English, which is not fetched. */
export let language = "en";
let catalogue: Catalogue | null = null;

/** Return a part of a catalogue; its texts are in the language in use when they are read. */
export function spoken<Name extends keyof Catalogue>(name: Name, english: Catalogue[Name]): Catalogue[Name] {
  return new Proxy(english, { get: (_, key) => Reflect.get(catalogue?.[name] ?? english, key) });
}

/** Whether a tag's language has to be fetched. */
export function isFetched(tag: string): boolean {
  return Object.hasOwn(others, languageOf(tag));
}

/** Fetch the catalogue of a tag's language and use it from then on; English if it cannot be fetched. */
export async function speakAs(tag: string): Promise<void> {
  catalogue = isFetched(tag) ? await others[languageOf(tag)]!().catch(() => null) : null;
  language = catalogue === null ? "en" : languageOf(tag);
}

/** Resolves when a worker has its catalogue; the page names the worker after the language. */
export function workerSpeaks(): Promise<void> {
  return speakAs(self.name);
}
