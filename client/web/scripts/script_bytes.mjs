/** What the viewer's page loads before anyone refines: its scripts, what those import, and the workers that it starts. */

import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

/** Return the size of every such script in a folder of built pages, gzip -9, by its file name. */
export function scriptBytes(pages) {
  const start = readFileSync(join(pages, "viewer.html"), "utf8").matchAll(/src="\.\/assets\/([^"]+\.js)"/g);
  const workers = readdirSync(join(pages, "assets")).filter((name) =>
    /^(bundle|light)Worker.*\.js$/.test(name),
  );
  const names = new Set([...[...start].map(([, name]) => name), ...workers]);
  const found = {};
  for (const name of names) {
    const text = readFileSync(join(pages, "assets", name));
    found[name] = gzipSync(text, { level: 9 }).length;
    for (const [, other] of text.toString().matchAll(/(?:from|import)\s*"\.\/([^"]+\.js)"/g))
      names.add(other);
  }
  return found;
}
