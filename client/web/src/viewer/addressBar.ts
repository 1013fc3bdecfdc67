/** The address of the viewer's own page follows what is shown, so that loading it again brings that back. */

import { linkOf } from "./links.js";
import type { Viewer } from "./viewer.js";

/** Browsers refuse more than a hundred changes in half a minute. */
const intervalMs = 500;

type Page = {
  readonly location: Pick<Location, "href" | "reload">;
  readonly history: Pick<History, "replaceState">;
};

/** Write the viewer's state into the page's address until `signal`. */
export function followAddress(viewer: Viewer, signal: AbortSignal, page: Page = globalThis): void {
  let waiting = 0;
  let dirty = false;
  const write = (): void => {
    dirty = false;
    const link = linkOf(viewer, page.location.href, true);
    if (link !== page.location.href) page.history.replaceState(null, "", link);
  };
  const follow = (): void => {
    // While the bundle is being read, what the address asks for is not shown yet.
    if (viewer.bundle === null) return;
    dirty = true;
    if (waiting !== 0) return;
    write();
    waiting = setTimeout(() => {
      waiting = 0;
      if (dirty) follow();
    }, intervalMs) as unknown as number;
  };
  const stops = [viewer.on("change", follow), viewer.on("load", follow)];
  signal.addEventListener("abort", () => {
    clearTimeout(waiting);
    for (const stop of stops) stop();
  });
}
