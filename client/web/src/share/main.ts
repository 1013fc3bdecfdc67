/** The page behind a share link. */

import { createApi } from "../page/rest.js";
import { openShare } from "./link.js";
import { speakAsBrowser, texts } from "../words/words.js";

await speakAsBrowser();
document.title = texts.share.title;
const place = document.querySelector("#message")!;
place.textContent = texts.share.opening;
const opened = await openShare(location.hash, createApi());
if ("viewer" in opened) {
  // Replaced, so that the secret does not stay in the history.
  location.replace(opened.viewer);
} else {
  place.textContent = opened.message;
}
