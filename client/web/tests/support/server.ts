/** Serves folders to tests, with the content security policy of our server. */

import { createReadStream, readFileSync, statSync } from "node:fs";
import { createServer, type Server, type ServerResponse } from "node:http";
import { extname, join, normalize } from "node:path";
import { gzipSync } from "node:zlib";

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

/** What a server does besides. */
export type Manner = {
  /** Whether pages share no process with others. */
  readonly isolated?: boolean;
  /** Whether whole files are sent compressed, as our server does it. */
  readonly gzip?: boolean;
  /** Called before each piece of a compressed file, with the share of it that was sent; the answer waits for it. */
  readonly piece?: (path: string, bytes: number, share: number) => Promise<void> | void;
};

const pieceBytes = 4096;

/** Serve folders under their names: `{ "": pages, bundle: folder }`. Ranges are answered. */
export async function serveFolders(
  folders: Readonly<Record<string, string>>,
  { isolated = false, gzip = false, piece }: Manner = {},
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
    if (range === null && gzip) {
      void sendPacked(response, headers, gzipSync(readFileSync(file)), (bytes, share) =>
        piece?.(path, bytes, share),
      );
      return;
    }
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

async function sendPacked(
  response: ServerResponse,
  headers: Record<string, string>,
  packed: Buffer,
  before: (bytes: number, share: number) => Promise<void> | void,
): Promise<void> {
  response.writeHead(200, { ...headers, "content-encoding": "gzip", "content-length": packed.length });
  for (let start = 0; start < packed.length; start += pieceBytes) {
    const piece = packed.subarray(start, start + pieceBytes);
    await before(piece.length, start / packed.length);
    response.write(piece);
  }
  response.end();
}
