/** The page behind a share link. */

import { createApi } from "../page/rest.js";
import { openShare } from "./open.js";

const opened = await openShare(location.hash, createApi());
if ("viewer" in opened) {
  // Replaced, so that the secret does not stay in the history.
  location.replace(opened.viewer);
} else {
  const place = document.querySelector("#message");
  if (place !== null) place.textContent = opened.message;
}
