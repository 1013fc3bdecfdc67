/** The viewer's page: one element that fills it, and an address that remembers what is shown. */

import { followAddress } from "./addressBar.js";
import { defineViewer, type LambentViewerElement } from "./element.js";
import { fillIn, speakAsBrowser, texts } from "../words/words.js";

await speakAsBrowser();
document.title = texts.viewer.page;
defineViewer();

const parameters = new URLSearchParams(location.hash.slice(1));
const element = document.createElement("lambent-viewer") as LambentViewerElement;
element.setAttribute("controls", "");
element.setAttribute("fullpage", "");
element.setAttribute("state", parameters.toString());
const source = parameters.get("src") ?? new URLSearchParams(location.search).get("src");
if (source !== null) element.setAttribute("src", source);
document.querySelector("main")?.append(element);
element.viewer?.on("load", (bundle) => {
  document.title = fillIn(texts.viewer.pageOf, { name: bundle.name });
});
if (element.viewer !== null) followAddress(element.viewer, new AbortController().signal);
// Someone typed another address, or went back to one.
addEventListener("hashchange", () => location.reload());
