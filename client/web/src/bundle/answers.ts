/** What a host's refusal means for someone who wanted to see a bundle. */

import { BundleFault } from "../page/fault.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** Return the fault for an unsuccessful answer; `path` is the file that was asked for, perhaps by a share link. */
export function refusal(status: number, path: string, address: URL, byLink = false): BundleFault {
  const asked = `"${path}" (${status})`;
  const isOurs = /\/v1\/bundles\//.test(address.pathname);
  switch (status) {
    case 401:
      if (byLink) {
        return new BundleFault("bundle.link_ended", bundleFaults.linkEnded);
      }
      return new BundleFault("bundle.login_needed", fillIn(bundleFaults.loginNeeded, { host: address.host }));
    case 403:
      return new BundleFault(
        "bundle.forbidden",
        fillIn(bundleFaults.forbidden, { host: address.host, file: asked }),
      );
    case 410:
      return new BundleFault("bundle.gone", fillIn(bundleFaults.gone, { file: asked }));
    case 429:
      return new BundleFault("bundle.server_busy", fillIn(bundleFaults.serverBusy, { host: address.host }));
  }
  if (status >= 500) {
    return new BundleFault(
      "bundle.server_failed",
      fillIn(bundleFaults.serverFailed, { host: address.host, status }),
    );
  }
  if (path !== "manifest.json") {
    return new BundleFault("bundle.file_missing", fillIn(bundleFaults.fileMissing, { file: asked }));
  }
  return new BundleFault(
    "bundle.manifest_missing",
    isOurs
      ? fillIn(bundleFaults.noSuchBundle, { host: address.host, status })
      : fillIn(bundleFaults.noManifestAt, { file: asked }),
  );
}

/** Return the fault for a request that nothing answered. */
export function silence(address: URL, isOnline: boolean): BundleFault {
  if (!isOnline) {
    return new BundleFault("bundle.offline", bundleFaults.offline);
  }
  return new BundleFault("bundle.missing", fillIn(bundleFaults.noAnswer, { origin: address.origin }));
}
