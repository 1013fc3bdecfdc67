/** The part of the panel that shares a bundle on our server; its code is loaded when it is opened. */

import { make, section } from "./fields.js";
import { toParameters } from "./state.js";
import type { Viewer } from "./viewer.js";
import { texts } from "../words/words.js";

/** Return the part; it is there for bundles of the server that the page came from, and only for those. */
export function sharing(viewer: Viewer): { element: HTMLElement; show: () => void } {
  const place = make("div", { className: "fields" });
  const news = make("p", { className: "hint", role: "alert" });
  const element = section(texts.panel.share, false, place, news);
  let filled = "";

  const fail = async (error: unknown): Promise<void> => {
    const { explain } = await import("../page/actions.js");
    news.textContent = explain(error);
  };
  const fill = async (id: string): Promise<void> => {
    const [{ sharePanel }, { createApi }] = await Promise.all([
      import("../share/panel.js"),
      import("../page/rest.js"),
    ]);
    if (filled !== id) return;
    const view = (): string => toParameters(viewer.state).toString();
    place.replaceChildren(sharePanel({ api: createApi(), fail: (error) => void fail(error), view }, id));
  };
  const show = (): void => {
    const id = viewer.serverBundle;
    element.hidden = id === null;
    if (id === null || !element.open || filled === id) return;
    filled = id;
    news.textContent = "";
    place.replaceChildren();
    fill(id).catch((error: unknown) => {
      filled = "";
      void fail(error);
    });
  };
  element.addEventListener("toggle", show);
  return { element, show };
}
