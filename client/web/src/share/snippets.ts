/** HTML that shows a shared object on another page. */

import { linkWithView } from "../page/addresses.js";
import type { Share } from "../page/rest.js";
import { texts } from "../words/words.js";

/** Return the origins in a text of addresses, in the form that browsers send; anything else stays as it is. */
export function originsIn(text: string): string[] {
  const found = text.split(/[\s,]+/).filter((each) => each !== "");
  return [...new Set(found.map(originOf))];
}

function originOf(text: string): string {
  try {
    const { origin } = new URL(text.includes("://") ? text : `https://${text}`);
    return origin === "null" ? text : origin;
  } catch {
    return text;
  }
}

function escaped(text: string): string {
  return text.replaceAll("&", "&amp;").replaceAll('"', "&quot;").replaceAll("<", "&lt;");
}

/** Return a frame with a link; `view` are parameters of what it shows. */
export function frameSnippet(share: Share, view: string): string {
  const address = escaped(linkWithView(share.url, view));
  return (
    `<iframe src="${address}" title="${escaped(texts.viewer.object)}" width="640" height="480" style="border:0" ` +
    `loading="lazy" allow="fullscreen"></iframe>`
  );
}

/** Return the element, with its script and its files on our server. */
export function elementSnippet(share: Share, view: string): string {
  const { origin, pathname, hash } = new URL(share.url);
  const source = `${origin}/v1/bundles/${share.bundle_id}${hash}`;
  const state = view === "" ? "" : ` state="${escaped(view)}"`;
  return [
    `<script type="module" src="${escaped(origin)}/lambent-viewer.js"></script>`,
    `<lambent-viewer src="${escaped(source)}"${state} poster="${escaped(origin + pathname)}/picture" loading="lazy" ` +
      `alt="${escaped(texts.viewer.object)}" style="height:480px"></lambent-viewer>`,
  ].join("\n");
}
