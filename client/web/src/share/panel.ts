/** Share links for one bundle. */

import { button } from "../page/actions.js";
import { h } from "../page/dom.js";
import { formatTime } from "../page/format.js";
import type { Api, Share } from "../page/rest.js";

/** The callbacks of the panel. */
export type ShareContext = {
  readonly api: Pick<Api, "shares" | "createShare" | "revokeShare">;
  readonly fail: (error: unknown) => void;
  /** Parameters of the view that a link opens with; none where it is left out. */
  readonly view?: () => string;
};

const dayS = 24 * 3600;
const lifetimes: readonly [string, number][] = [
  ["one day", dayS],
  ["one week", 7 * dayS],
  ["30 days", 30 * dayS],
  ["one year", 365 * dayS],
];

/** Return the address of a link with parameters of a view behind its secret. */
export function linkWithView(url: string, view: string): string {
  return view === "" ? url : `${url}&${view}`;
}

/** Return the panel that creates and revokes links. */
export function sharePanel(context: ShareContext, bundleId: string): HTMLElement {
  const { api, fail } = context;
  const linkOf = (share: Share): string => linkWithView(share.url, context.view?.() ?? "");
  const lifetime = h(
    "select",
    { id: "lifetime" },
    ...lifetimes.map(([name, seconds]) =>
      h("option", { value: seconds, selected: seconds === 7 * dayS }, name),
    ),
  );
  const list = h("ul", { class: "shares", "aria-label": "Links" });
  const news = h("p", { class: "faint", role: "status" });

  async function load(): Promise<void> {
    const { items } = await api.shares(bundleId);
    list.replaceChildren(...items.map(line));
  }
  load().catch(fail);

  function line(share: Share): HTMLLIElement {
    const ends = formatTime(share.expires_at);
    const address = h("input", {
      readonly: true,
      value: linkOf(share),
      "aria-label": `Link that ends ${ends}`,
    });
    address.addEventListener("focus", () => address.select());
    const copy = button("Copy", context, async () => {
      address.value = linkOf(share);
      address.select();
      // Pages that came over plain HTTP have no clipboard; the selection is then what can be offered.
      if (navigator.clipboard === undefined) throw new Error("Press Ctrl-C to copy the link.");
      await navigator.clipboard.writeText(address.value);
      news.textContent = "The link is copied.";
    });
    const revoke = button("Take back", context, async () => {
      await api.revokeShare(share.id);
      news.textContent = "The link no longer works.";
      await load();
    });
    revoke.setAttribute("aria-label", `Take back the link that expires ${ends}`);
    return h("li", {}, address, h("span", { class: "faint" }, `expires ${ends}`), copy, revoke);
  }

  const make = button("Make a link", context, async () => {
    const share = await api.createShare(bundleId, Number(lifetime.value));
    await load();
    news.textContent = (await copied(linkOf(share)))
      ? "The link was created and copied."
      : "The link was created.";
  });
  return h(
    "div",
    { id: "share" },
    h(
      "p",
      { class: "faint" },
      "Anyone with the link can see this one object and nothing else until it expires.",
    ),
    h("div", { class: "actions" }, h("label", { for: "lifetime" }, "The link works for"), lifetime, make),
    news,
    list,
  );
}

/** Put a text on the clipboard; returns whether the browser lets us. */
async function copied(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}
