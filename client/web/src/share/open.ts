/** The page behind a share link: exchanges the secret in its fragment for a cookie and opens the viewer. */

import { viewerAddress } from "../page/addresses.js";
import { type Api, Refused } from "../page/rest.js";
import { texts } from "../words/words.js";

export type Opened = { readonly viewer: string } | { readonly message: string };

/** Return where the viewer shows the bundle of a link, or what to tell the visitor. */
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
