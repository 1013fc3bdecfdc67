/** What a host's refusal means for someone who wanted to see a bundle. */

import { BundleFault } from "./fault.js";

/** Return the fault for an answer that was no success; `path` is the file that was asked for, perhaps by a share link. */
export function refusal(status: number, path: string, address: URL, byLink = false): BundleFault {
  const asked = `"${path}" (${status})`;
  const isOurs = /\/v1\/bundles\//.test(address.pathname);
  switch (status) {
    case 401:
      if (byLink) {
        return new BundleFault(
          "bundle.link_ended",
          "the link to this object is invalid, has expired or was taken back",
          "ask the person who sent it for a new one",
        );
      }
      return new BundleFault(
        "bundle.login_needed",
        `this browser is not logged in at ${address.host}, which keeps the bundle`,
        "open the one-time link that `lambent serve` prints, or ask for a share link, then try again",
      );
    case 403:
      return new BundleFault(
        "bundle.forbidden",
        `${address.host} does not let this browser read ${asked}`,
        "ask whoever keeps the bundle for a share link",
      );
    case 410:
      return new BundleFault(
        "bundle.gone",
        `${asked} has been deleted`,
        "choose another bundle, or export the scene again",
      );
    case 429:
      return new BundleFault(
        "bundle.server_busy",
        `${address.host} has too many requests (429)`,
        "try again in a minute",
      );
  }
  if (status >= 500) {
    return new BundleFault(
      "bundle.server_failed",
      `${address.host} has a problem of its own (${status})`,
      "try again in a minute; if that does not help, its operator finds the reason in the log",
    );
  }
  if (path !== "manifest.json") {
    return new BundleFault(
      "bundle.file_missing",
      `${asked} is not there`,
      "fetch or export the bundle again",
    );
  }
  return new BundleFault(
    "bundle.manifest_missing",
    isOurs ? `${address.host} has no such bundle (${status})` : `${asked} is not there`,
    isOurs
      ? "it may have been deleted: look at the list of bundles"
      : "give the address of the folder that holds manifest.json",
  );
}

/** Return the fault for a request that nothing answered. */
export function silence(address: URL, isOnline: boolean): BundleFault {
  if (!isOnline) {
    return new BundleFault("bundle.offline", "this device is offline", "connect it, then try again");
  }
  return new BundleFault(
    "bundle.missing",
    `nothing answers at ${address.origin}`,
    "check the address, the connection, and that the host allows other sites to read it",
  );
}
