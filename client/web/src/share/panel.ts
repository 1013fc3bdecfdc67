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
  /** Parameters of the view that a link opens with. */
  readonly view?: () => string;
};

const dayS = 24 * 3600;
const lifetimes = { day: dayS, week: 7 * dayS, month: 30 * dayS, year: 365 * dayS } as const;
type Lifetime = keyof typeof lifetimes;

/** Return the panel that creates and revokes links. */
export function sharePanel(context: ShareContext, bundleId: string): HTMLElement {
  const { api, fail } = context;
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
  const tell = (text: string): void => {
    news.textContent = text;
  };

  async function load(): Promise<void> {
    const { items } = await api.shares(bundleId);
    list.replaceChildren(...items.map((share) => line(context, share, tell, load)));
  }
  load().catch(fail);

  const make = button(texts.share.create, context, async () => {
    const share = await api.createShare(bundleId, Number(lifetime.value), originsIn(sites.value));
    await load();
    tell((await copied(linkOf(context, share))) ? texts.share.createdAndCopied : texts.share.created);
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

function linkOf({ view }: ShareContext, share: Share): string {
  return linkWithView(share.url, view?.() ?? "");
}

/** Return a link of the list; `load` reads the list again. */
function line(
  context: ShareContext,
  share: Share,
  tell: (text: string) => void,
  load: () => Promise<void>,
): HTMLLIElement {
  const ends = formatTime(share.expires_at);
  const address = h("input", {
    readonly: true,
    value: linkOf(context, share),
    "aria-label": fillIn(texts.share.linkUntil, { time: ends }),
    onfocus: () => address.select(),
  });
  const copy = button(texts.share.copy, context, async () => {
    address.value = linkOf(context, share);
    address.select();
    // Pages that came over plain HTTP have no clipboard; the selection is then what can be offered.
    if (navigator.clipboard === undefined) throw new Error(texts.share.copyByKey);
    await navigator.clipboard.writeText(address.value);
    tell(texts.link.copied);
  });
  const html = (label: string, snippet: (share: Share, view: string) => string) =>
    button(label, context, async () => {
      const text = snippet(share, context.view?.() ?? "");
      if (!(await copied(text))) throw new Error(fillIn(texts.share.copyHere, { text }));
      tell(texts.share.htmlCopied);
    });
  const origins = share.frame_ancestors ?? [];
  const embedding =
    origins.length === 0
      ? []
      : [
          h("span", { class: "faint" }, fillIn(texts.share.sites, { sites: origins.join(", ") })),
          html(texts.share.copyFrame, frameSnippet),
          html(texts.share.copyElement, elementSnippet),
        ];
  const revoke = button(texts.share.revoke, context, async () => {
    await context.api.revokeShare(share.id);
    tell(texts.share.revoked);
    await load();
  });
  revoke.setAttribute("aria-label", fillIn(texts.share.revokeUntil, { time: ends }));
  const expires = h("span", { class: "faint" }, fillIn(texts.share.expires, { time: ends }));
  return h("li", {}, address, expires, copy, revoke, ...embedding);
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
