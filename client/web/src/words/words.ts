/** The texts of the pages, in the chosen language; a page has one. */

import {
  bundleFaults as bundles,
  deviceFaults as devices,
  mapFaults as maps,
  texts as pages,
} from "./en.json";
import { chosen, isFetched, language, speakAs, spoken } from "./languages.js";

// Pure, so that the script of a worker contains only the parts that it uses.
export const texts = /* @__PURE__ */ spoken("texts", pages);
export const bundleFaults = /* @__PURE__ */ spoken("bundleFaults", bundles);
export const mapFaults = /* @__PURE__ */ spoken("mapFaults", maps);
export const deviceFaults = /* @__PURE__ */ spoken("deviceFaults", devices);

/** The tag of the chosen language, for numbers and times: "en-GB". */
export let locale = "en";

/** Use the language of a tag from now on; resolves when its catalogue is loaded. */
export async function speak(tag: string): Promise<void> {
  await speakAs(tag);
  // Numbers match the words, also where the catalogue could not be fetched.
  locale = isFetched(tag) && language === "en" ? "en" : tag;
}

/** Use the browser's language, on a page of our own. */
export async function speakAsBrowser(): Promise<void> {
  await speak(chosen(navigator.languages));
  document.documentElement.lang = locale;
}

/** Return the language at the first element `name`: its own attribute `lang`, or that of what surrounds it. */
export function languageOfPage(name: string): string {
  const element = document.querySelector(name) ?? document.documentElement;
  return chosen([element.closest("[lang]")?.getAttribute("lang") ?? ""]);
}

/** Return the name of a code, or the code itself if this page does not know it. */
export function named(names: Readonly<Record<string, string>>, code: string): string {
  return Object.hasOwn(names, code) ? names[code]! : code;
}

/** A message in the plural forms of a language for the number `n`; missing forms are as `other`. */
export type Forms = Partial<Record<Intl.LDMLPluralRule, string>> & { readonly other: string };

type Values = Readonly<Record<string, string | number>>;

/** Return a message with values in its places; `npm test` compares their names with those of the message. */
export function fillIn(message: string | Forms, values: Values): string {
  if (typeof message === "string") return message.replace(/\{(\w+)\}/g, (_, name) => String(values[name]));
  const count = Number(values.n);
  const form = message[new Intl.PluralRules(language).select(count)] ?? message.other;
  return fillIn(form, { ...values, n: new Intl.NumberFormat(language).format(count) });
}
