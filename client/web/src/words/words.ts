/** What the pages say, in the language that was chosen; one for all that is on a page. */

import { texts as english } from "./en.json";
import { chosen, isFetched, language, speakAs, spoken } from "./languages.js";

export const texts = spoken("texts", english);

/** The tag of the chosen language, for numbers and times: "en-GB". */
export let locale = "en";

/** Speak the language of a tag from now on, once its catalogue is there. */
export async function speak(tag: string): Promise<void> {
  await speakAs(tag);
  // Numbers go with the words, also where those could not be fetched.
  locale = isFetched(tag) && language === "en" ? "en" : tag;
}

/** Speak as the browser does, on a page of our own. */
export async function speakAsBrowser(): Promise<void> {
  await speak(chosen(navigator.languages));
  document.documentElement.lang = locale;
}

/** Return the language of the page where the first element `name` is: of its own attribute `lang`, or what it is in. */
export function languageOfPage(name: string): string {
  const element = document.querySelector(name) ?? document.documentElement;
  return chosen([element.closest("[lang]")?.getAttribute("lang") ?? ""]);
}

/** Return what a code is called, or the code itself where this page does not know it. */
export function named(names: Readonly<Record<string, string>>, code: string): string {
  return Object.hasOwn(names, code) ? names[code]! : code;
}
