/** What the page of a share link shows. */

import { texts } from "../words/words.js";

export type SharedView = {
  /** The bundle's address, with the secret. */
  readonly source: string;
  readonly poster: string;
  /** Parameters of the view. */
  readonly state: string;
  /** Whether there are controls; null where the link does not say. */
  readonly controls: boolean | null;
};

/**
 * Return what to show, or a message to the visitor. The fragment of the page's address is the secret and, after "&",
 * the view. `bundleId` comes with the page; it is empty once the link has ended.
 */
export function sharedView(
  { pathname, hash, origin }: Pick<Location, "pathname" | "hash" | "origin">,
  bundleId: string,
): SharedView | { readonly message: string } {
  const [secret = "", view = ""] = hash.replace(/^#/, "").split(/&(.*)/s);
  if (bundleId === "") {
    return { message: texts.share.ended };
  }
  if (secret === "") return { message: texts.share.incomplete };
  const parameters = new URLSearchParams(view);
  const controls = parameters.get("controls");
  parameters.delete("controls");
  parameters.delete("src");
  return {
    source: `${origin}/v1/bundles/${encodeURIComponent(bundleId)}#${secret}`,
    poster: `${origin}${pathname.replace(/\/$/, "")}/picture`,
    state: parameters.toString(),
    controls: controls === null ? null : controls === "1",
  };
}
