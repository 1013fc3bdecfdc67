/** Addresses inside this site. */

/** Return the address of the viewer with a bundle of this server. */
export function viewerAddress(bundleId: string): string {
  return `viewer.html#${new URLSearchParams({ src: `/v1/bundles/${bundleId}` })}`;
}

/** Return the id of the bundle at an address, where that is one of the server that `page` came from; else null. */
export function bundleAt(address: string, page: string): string | null {
  const url = new URL(address, page);
  if (url.origin !== new URL(page).origin) return null;
  return /^\/v1\/bundles\/([a-z0-9_]{1,64})\/?$/.exec(url.pathname)?.[1] ?? null;
}

/** Return the address of a link with parameters of a view behind its secret. */
export function linkWithView(url: string, view: string): string {
  return view === "" ? url : `${url}&${view}`;
}

/** Return the address of a bundle as one file. */
export function archiveAddress(bundleId: string): string {
  return `/v1/bundles/${bundleId}/archive`;
}

/** Return the address of bytes that the server names by their hash. */
export function blobAddress(sha256: string): string {
  return `/v1/blobs/${sha256}`;
}

/** Return the address of a scene's page. */
export function sceneAddress(sceneId: string): string {
  return `#/scenes/${sceneId}`;
}

/** Return the address of the page with the masks of a scene. */
export function masksAddress(sceneId: string): string {
  return `#/scenes/${sceneId}/masks`;
}

/** Return the address of a job's page. */
export function jobAddress(jobId: string): string {
  return `#/jobs/${jobId}`;
}

/** The view that an address of this page opens. */
export type Place =
  | { readonly kind: "start" }
  | { readonly kind: "scene"; readonly id: string }
  | { readonly kind: "masks"; readonly id: string }
  | { readonly kind: "job"; readonly id: string };

/** Return the view that a fragment names; anything else opens the start. */
export function placeOf(fragment: string): Place {
  const found = /^#\/(scenes|jobs)\/([a-z0-9_]{1,64})(\/masks)?$/.exec(fragment);
  if (found === null || (found[1] === "jobs" && found[3] !== undefined)) return { kind: "start" };
  if (found[3] !== undefined) return { kind: "masks", id: found[2]! };
  return { kind: found[1] === "jobs" ? "job" : "scene", id: found[2]! };
}
