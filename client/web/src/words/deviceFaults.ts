/** What is wrong with browsers and graphics cards, in the language of the page; workers say it, too. */

import { type DeviceFaults, deviceFaults as english } from "./en.js";
import { onSpeech } from "./languages.js";

/** Read it when something is said: it is English until another catalogue is there. */
export let deviceFaults: DeviceFaults = english;

onSpeech((catalogue) => {
  deviceFaults = catalogue?.deviceFaults ?? english;
});
