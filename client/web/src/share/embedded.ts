/** The page of a share link, by itself or in a frame of another site. */

import { defineViewer } from "../viewer/element.js";
import { sharedView } from "./link.js";
import { speakAsBrowser } from "../words/words.js";

await speakAsBrowser();
const place = document.querySelector("main");
const framed = window.parent !== window;
document.documentElement.classList.toggle("framed", framed);
const bundleId = document.querySelector<HTMLMetaElement>("meta[name=lambent-bundle]")?.content ?? "";
const shown = sharedView(location, bundleId);
if ("message" in shown) {
  const text = document.createElement("p");
  text.role = "alert";
  text.textContent = shown.message;
  place?.classList.add("alone");
  place?.replaceChildren(text);
} else {
  defineViewer();
  const element = document.createElement("lambent-viewer");
  element.setAttribute("alt", document.title);
  element.setAttribute("state", shown.state);
  element.setAttribute("src", shown.source);
  // A bundle without baked transport has no poster.
  if (document.querySelector("meta[property='og:image']") !== null) {
    element.setAttribute("poster", shown.poster);
  }
  // A frame seldom has room for controls, and the wheel belongs to the page around it.
  element.toggleAttribute("controls", shown.controls ?? !framed);
  element.toggleAttribute("fullpage", !framed);
  element.toggleAttribute("light-turn", true);
  place?.append(element);
}
