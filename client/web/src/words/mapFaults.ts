/** What is wrong with environment maps, in the language of the page; workers say it, too. */

import { type MapFaults, mapFaults as english } from "./en.js";
import { onSpeech } from "./languages.js";

/** Read it when something is said: it is English until another catalogue is there. */
export let mapFaults: MapFaults = english;

onSpeech((catalogue) => {
  mapFaults = catalogue?.mapFaults ?? english;
});
