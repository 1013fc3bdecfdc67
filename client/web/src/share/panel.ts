/** Share links for one bundle. */

import { button } from "../page/actions.js";
import { linkWithView } from "../page/addresses.js";
import { h } from "../page/dom.js";
import { formatTime } from "../page/format.js";
import type { Api, Share } from "../page/rest.js";
import { elementSnippet, frameSnippet, originsIn } from "./snippets.js";

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
  const sites = h("input", {
    id: "sites",
    type: "text",
    placeholder: "https://shop.example",
    maxlength: 2000,
  });
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
    const put = (text: string, what: string) => async (): Promise<void> => {
      if (!(await copied(text))) throw new Error(`This page cannot use the clipboard. Copy it here: ${text}`);
      news.textContent = `The HTML of ${what} is copied.`;
    };
    const view = (): string => context.view?.() ?? "";
    const origins = share.frame_ancestors ?? [];
    const embedding =
      origins.length === 0
        ? []
        : [
            h("span", { class: "faint" }, `may be shown on ${origins.join(", ")}`),
            button("Copy a frame", context, () => put(frameSnippet(share, view()), "a frame")()),
            button("Copy the element", context, () => put(elementSnippet(share, view()), "the element")()),
          ];
    const revoke = button("Take back", context, async () => {
      await api.revokeShare(share.id);
      news.textContent = "The link no longer works.";
      await load();
    });
    revoke.setAttribute("aria-label", `Take back the link that expires ${ends}`);
    const expires = h("span", { class: "faint" }, `expires ${ends}`);
    return h("li", {}, address, expires, copy, revoke, ...embedding);
  }

  const make = button("Make a link", context, async () => {
    const share = await api.createShare(bundleId, Number(lifetime.value), originsIn(sites.value));
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
    h(
      "div",
      { class: "actions" },
      h("label", { for: "lifetime" }, "The link works for"),
      lifetime,
      h("label", { for: "sites" }, "Sites that may show it"),
      sites,
      make,
    ),
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
