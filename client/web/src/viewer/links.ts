/** Links to what a viewer shows. */

import type { BundleOrigin } from "../bundle/source.js";
import { toParameters, type ViewerState } from "./state.js";

/** The parts of a viewer that a link is about. */
export type Linked = { readonly state: ViewerState; readonly source: BundleOrigin | null };

/** Return the address of a viewer's page, `href`, for what a viewer shows. */
export function linkOf({ state, source }: Linked, href: string): string {
  const address = new URL(href);
  const before = new URLSearchParams(address.hash.slice(1)).get("src") ?? address.searchParams.get("src");
  const parameters = toParameters(state);
  address.searchParams.delete("src");
  if (source?.kind === "url") {
    // The address is kept as it was written: relative ones still work when the page moves.
    const same = before !== null && new URL(before, href).href === source.url;
    parameters.set("src", same ? before : source.url);
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
