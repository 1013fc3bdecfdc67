/** Links to what a viewer shows. */

import type { BundleOrigin } from "../bundle/source.js";
import { linkWithView } from "../page/addresses.js";
import { toParameters, type ViewerState } from "./state.js";

/** The parts of a viewer that a link is about. */
export type Linked = { readonly state: ViewerState; readonly source: BundleOrigin | null };

/**
 * Return the address of the page at `href` for what a viewer shows on it. `full` where the page is the viewer's, so that
 * the address names the bundle, too; on other pages that is what the page says.
 */
export function linkOf({ state, source }: Linked, href: string, full: boolean): string {
  const address = new URL(href);
  const fragment = address.hash.slice(1);
  const parameters = toParameters(state);
  // The page of a share link has its secret in front, which says which bundle it is.
  const secret = /^share_[^&=]*/.exec(fragment)?.[0];
  if (secret !== undefined) {
    address.hash = linkWithView(secret, parameters.toString());
    return address.href;
  }
  if (full) {
    const before = new URLSearchParams(fragment).get("src") ?? address.searchParams.get("src");
    address.searchParams.delete("src");
    // The address is kept as it was written: relative ones still work when the page moves.
    const isSame = source?.kind === "url" && before !== null && new URL(before, href).href === source.url;
    if (source?.kind === "url") parameters.set("src", isSame ? before : source.url);
  }
  address.hash = parameters.toString();
  return address.href;
}

/** What a link cannot carry. */
export type Missing = {
  /** The bundle is on this computer only. */
  readonly bundle: boolean;
  /** Names of maps on this computer that the picture is lit with. */
  readonly maps: readonly string[];
};

/** Return what a link to this view leaves out. */
export function missingOf({ state, source }: Linked): Missing {
  const lights =
    state.compare === "environment" ? [state.environment, state.environmentB] : [state.environment];
  const maps = lights.filter((name) => name.startsWith("file:")).map((name) => name.slice(5));
  return { bundle: source !== null && source.kind !== "url", maps: [...new Set(maps)] };
}
