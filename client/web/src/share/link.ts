/** What the pages of a share link show. */

import { viewerAddress } from "../page/addresses.js";
import { type Api, Refused } from "../page/rest.js";
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
 * Return what to show, or what to tell the visitor: the fragment of the page's address is the secret and, after "&", the
 * view. `bundleId` comes with the page; it is empty after the end of the link.
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

export type Opened = { readonly viewer: string } | { readonly message: string };

/** Exchange the secret in a fragment for a cookie; return where the viewer shows the bundle, or what to tell the visitor. */
export async function openShare(fragment: string, api: Pick<Api, "openShare">): Promise<Opened> {
  const [token = "", view] = fragment.replace(/^#/, "").split(/&(.*)/s);
  if (token === "") return { message: texts.share.incomplete };
  try {
    const opened = await api.openShare(token);
    return { viewer: viewerAddress(opened.bundle_id, view) };
  } catch (error) {
    if (error instanceof Refused && error.status < 500) {
      return { message: texts.share.ended };
    }
    return { message: texts.share.noServer };
  }
}
