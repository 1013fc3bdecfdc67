/** What is wrong with bundles, in the language of the page; workers say it, too. */

import { type BundleFaults, bundleFaults as english } from "./en.js";
import { onSpeech } from "./languages.js";

/** Read it when something is said: it is English until another catalogue is there. */
export let bundleFaults: BundleFaults = english;

onSpeech((catalogue) => {
  bundleFaults = catalogue?.bundleFaults ?? english;
});
