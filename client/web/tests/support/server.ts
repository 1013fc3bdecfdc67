/** Serves folders to tests, with the content security policy of our server. */

import { createReadStream, statSync } from "node:fs";
import { createServer, type Server } from "node:http";
import { extname, join, normalize } from "node:path";

const types: Readonly<Record<string, string>> = {
  ".html": "text/html",
  ".js": "text/javascript",
  ".css": "text/css",
  ".json": "application/json",
  ".png": "image/png",
  ".svg": "image/svg+xml",
};
const policy =
  "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; " +
  "worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/** A server on a port of this machine. */
export type TestServer = { readonly url: string; readonly close: () => Promise<void> };

/** Headers of pages that share no process with others. */
const isolation = {
  "cross-origin-opener-policy": "same-origin",
  "cross-origin-embedder-policy": "require-corp",
};

/** Serve folders under their names: `{ "": pages, bundle: folder }`. Ranges are answered. */
export async function serveFolders(
  folders: Readonly<Record<string, string>>,
  { isolated = false } = {},
): Promise<TestServer> {
  const server: Server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url ?? "/", "http://localhost").pathname).slice(1);
    const name = Object.keys(folders)
      .filter((each) => each === "" || path.startsWith(`${each}/`))
      .sort((a, b) => b.length - a.length)[0];
    const rest = normalize(path.slice(name ? name.length + 1 : 0));
    const file = name === undefined || rest.startsWith("..") ? null : join(folders[name]!, rest);
    const found = file === null ? undefined : statSync(file, { throwIfNoEntry: false });
    if (file === null || !found?.isFile()) {
      response.writeHead(404).end();
      return;
    }
    const headers = {
      "content-type": types[extname(file)] ?? "application/octet-stream",
      "content-security-policy": policy,
      "cache-control": "no-store",
      ...(isolated ? isolation : {}),
    };
    const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    if (range === null) {
      response.writeHead(200, { ...headers, "content-length": found.size });
      createReadStream(file).pipe(response);
      return;
    }
    const [start, end] = [Number(range[1]), Math.min(Number(range[2]), found.size - 1)];
    response.writeHead(206, {
      ...headers,
      "content-length": end - start + 1,
      "content-range": `bytes ${start}-${end}/${found.size}`,
    });
    createReadStream(file, { start, end }).pipe(response);
  });
  await new Promise<void>((resolve) => {
    server.listen(0, "127.0.0.1", resolve);
  });
  const address = server.address();
  if (address === null || typeof address === "string") throw new Error("no port");
  return {
    url: `http://127.0.0.1:${address.port}`,
    close: () =>
      new Promise((resolve) => {
        server.closeAllConnections();
        server.close(() => resolve());
      }),
  };
}
