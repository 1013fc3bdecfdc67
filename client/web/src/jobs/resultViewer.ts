/** The viewer inside a page: its picture first, the renderer once it is near the window. */

import { explain } from "../page/actions.js";
import { h } from "../page/dom.js";
import { fillIn, texts } from "../words/words.js";

/** Where the files of a bundle are. */
export type Shown = {
  readonly bundleId: string;
  readonly name: string;
  /** Address of a picture of the object; null where the bundle has none. */
  readonly poster: string | null;
};

/** Return the element; the renderer and the bundle are loaded when it comes near the window. */
export function resultViewer({ bundleId, name, poster }: Shown): HTMLElement {
  const picture =
    poster === null
      ? null
      : h("img", { src: poster, alt: fillIn(texts.results.relit, { name }), class: "poster" });
  const news = h("p", { class: "loading", role: "status" }, texts.results.loadingViewer);
  const frame = h("div", { class: "viewer" }, picture, news);

  async function start(): Promise<void> {
    // Three.js and the shaders are larger than all of this page, and most visits to a list need neither.
    const { defineViewer } = await import("../viewer/element.js");
    defineViewer();
    const element = document.createElement("lambent-viewer");
    element.setAttribute("alt", name);
    element.setAttribute("src", `/v1/bundles/${bundleId}`);
    element.toggleAttribute("light-turn", true);
    element.classList.add("arriving");
    frame.append(element);
    await (element as HTMLElement & { ready: Promise<void> }).ready;
    element.classList.remove("arriving");
    picture?.remove();
    news.remove();
  }

  const watcher = new IntersectionObserver(
    (entries) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      watcher.disconnect();
      start().catch((error) => {
        // The picture stays.
        frame.querySelector("lambent-viewer")?.remove();
        news.textContent = fillIn(texts.results.noViewer, { why: explain(error) });
      });
    },
    { rootMargin: "200px" },
  );
  watcher.observe(frame);
  return frame;
}
