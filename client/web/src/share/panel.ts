/** Share links for one bundle. */

import { button } from "../page/actions.js";
import { linkWithView } from "../page/addresses.js";
import { h } from "../page/dom.js";
import { formatTime } from "../page/format.js";
import type { Api, Share } from "../page/rest.js";
import { elementSnippet, frameSnippet, originsIn } from "./snippets.js";
import { fillIn, texts } from "../words/words.js";

/** The callbacks of the panel. */
export type ShareContext = {
  readonly api: Pick<Api, "shares" | "createShare" | "revokeShare">;
  readonly fail: (error: unknown) => void;
  /** Parameters of the view that a link opens with; none where it is left out. */
  readonly view?: () => string;
};

const dayS = 24 * 3600;
const lifetimes = { day: dayS, week: 7 * dayS, month: 30 * dayS, year: 365 * dayS } as const;
type Lifetime = keyof typeof lifetimes;

/** Return the panel that creates and revokes links. */
export function sharePanel(context: ShareContext, bundleId: string): HTMLElement {
  const { api, fail } = context;
  const linkOf = (share: Share): string => linkWithView(share.url, context.view?.() ?? "");
  const lifetime = h(
    "select",
    { id: "lifetime" },
    ...(Object.keys(lifetimes) as Lifetime[]).map((name) =>
      h("option", { value: lifetimes[name], selected: name === "week" }, texts.share.lifetimes[name]),
    ),
  );
  const sites = h("input", {
    id: "sites",
    type: "text",
    placeholder: "https://shop.example",
    maxlength: 2000,
  });
  const list = h("ul", { class: "shares", "aria-label": texts.share.links });
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
      "aria-label": fillIn(texts.share.linkUntil, { time: ends }),
    });
    address.addEventListener("focus", () => address.select());
    const copy = button(texts.share.copy, context, async () => {
      address.value = linkOf(share);
      address.select();
      // Pages that came over plain HTTP have no clipboard; the selection is then what can be offered.
      if (navigator.clipboard === undefined) throw new Error(texts.share.copyByKey);
      await navigator.clipboard.writeText(address.value);
      news.textContent = texts.share.copied;
    });
    const put = (text: string) => async (): Promise<void> => {
      if (!(await copied(text))) throw new Error(fillIn(texts.share.copyHere, { text }));
      news.textContent = texts.share.htmlCopied;
    };
    const view = (): string => context.view?.() ?? "";
    const origins = share.frame_ancestors ?? [];
    const embedding =
      origins.length === 0
        ? []
        : [
            h("span", { class: "faint" }, fillIn(texts.share.sites, { sites: origins.join(", ") })),
            button(texts.share.copyFrame, context, () => put(frameSnippet(share, view()))()),
            button(texts.share.copyElement, context, () => put(elementSnippet(share, view()))()),
          ];
    const revoke = button(texts.share.revoke, context, async () => {
      await api.revokeShare(share.id);
      news.textContent = texts.share.revoked;
      await load();
    });
    revoke.setAttribute("aria-label", fillIn(texts.share.revokeUntil, { time: ends }));
    const expires = h("span", { class: "faint" }, fillIn(texts.share.expires, { time: ends }));
    return h("li", {}, address, expires, copy, revoke, ...embedding);
  }

  const make = button(texts.share.create, context, async () => {
    const share = await api.createShare(bundleId, Number(lifetime.value), originsIn(sites.value));
    await load();
    news.textContent = (await copied(linkOf(share))) ? texts.share.createdAndCopied : texts.share.created;
  });
  return h(
    "div",
    { id: "share" },
    h("p", { class: "faint" }, texts.share.about),
    h(
      "div",
      { class: "actions" },
      h("label", { for: "lifetime" }, texts.share.worksFor),
      lifetime,
      h("label", { for: "sites" }, texts.share.allowedSites),
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
