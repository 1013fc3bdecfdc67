/** Sources of a bundle's files: a web folder, our server, a zip archive, dropped files. */

import { refusal, silence } from "./answers.js";
import { BundleFault, fetchAgain, unsafe } from "../page/fault.js";
import { ZipArchive, type RangeReader } from "./zip.js";
import { bundleFaults, fillIn } from "../words/words.js";

type Bytes = Uint8Array<ArrayBuffer>;

/** Read access to the files of a bundle by their path inside it. */
export type FileSource = {
  /** All paths, or null where they cannot be listed. */
  readonly paths: ReadonlySet<string> | null;
  readonly read: (path: string, limitBytes: number) => Promise<Bytes>;
  /** What reads a file's beginning first; absent where reading is quick. */
  readonly parts?: PartialReader;
};

/** Reads the beginning of a file before the rest of it. */
export type PartialReader = {
  /** Return the first bytes of a file alone, uncompressed, or all of it where the host sends no parts. */
  readonly head: (path: string, bytes: number, limitBytes: number) => Promise<Bytes>;
  /** Return the first bytes of a file as soon as they are there, and a promise of all of it, which is read on. */
  readonly stream: (path: string, bytes: number, limitBytes: number) => Promise<Streamed>;
};

/** A file that is being read: its first bytes, or all where there are fewer, and all of it. */
export type Streamed = { readonly data: Bytes; readonly whole: Promise<Bytes> };

/** The origin of a bundle; can be sent to a worker. The secret of a share link may follow an address, after "#". */
export type BundleOrigin =
  | { readonly kind: "url"; readonly url: string }
  | { readonly kind: "archive"; readonly file: Blob }
  | { readonly kind: "files"; readonly files: ReadonlyMap<string, Blob> };

/** Return the files behind an origin; throws BundleFault where there are none. */
export async function openSource(origin: BundleOrigin): Promise<FileSource> {
  if (origin.kind === "archive") return zipSource(await ZipArchive.ofFile(origin.file));
  if (origin.kind === "files") return droppedSource(origin.files);
  const url = new URL(origin.url);
  if (url.pathname.endsWith(".zip")) return remoteArchive(url);
  return folderSource(url);
}

function tooLarge(path: string, limitBytes: number): BundleFault {
  return unsafe("bundle.too_large", fillIn(bundleFaults.tooLarge, { path, bytes: limitBytes }));
}

/** Return the secret of a share link behind an address, or null; it goes to our server's files only, in a header. */
export function secretOf(address: string): string | null {
  const { hash, pathname } = new URL(address);
  const secret = /^#(share_[a-z0-9]{1,40}\.[0-9a-f]{64})$/.exec(hash)?.[1];
  return secret !== undefined && ourBundle.test(pathname) ? secret : null;
}

const ourBundle = /\/v1\/bundles\/[^/]+\/?$/;

async function request(url: URL, headers: Record<string, string> = {}): Promise<Response> {
  // Who reads with a secret reads with nothing else.
  const credentials = "authorization" in headers ? "omit" : "same-origin";
  try {
    return await fetch(url, { headers, credentials });
  } catch {
    throw silence(url, globalThis.navigator?.onLine ?? true);
  }
}

/** Files below an address; `.../v1/bundles/ID` of our server keeps them under /files. */
function folderSource(given: URL): FileSource {
  const base = new URL(given.href);
  base.search = "";
  base.hash = "";
  const secret = secretOf(given.href);
  const headers = secret === null ? {} : { authorization: `Bearer ${secret}` };
  if (ourBundle.test(base.pathname)) {
    base.pathname = `${base.pathname.replace(/\/$/, "")}/files/`;
  }
  if (!base.pathname.endsWith("/")) base.pathname += "/";
  const ask = async (path: string, limitBytes: number, more: Record<string, string> = {}) => {
    const address = new URL(path.split("/").map(encodeURIComponent).join("/"), base);
    const response = await request(address, { ...headers, ...more });
    if (!response.ok) throw refusal(response.status, path, address, secret !== null);
    if (Number(response.headers.get("content-length") ?? 0) > limitBytes) throw tooLarge(path, limitBytes);
    return response;
  };
  const get = async (path: string, limitBytes: number, more: Record<string, string> = {}): Promise<Bytes> => {
    const data = new Uint8Array(await (await ask(path, limitBytes, more)).arrayBuffer());
    if (data.length > limitBytes) throw tooLarge(path, limitBytes);
    return data;
  };
  return {
    paths: null,
    read: (path, limitBytes) => get(path, limitBytes),
    parts: {
      head: (path, bytes, limitBytes) => get(path, limitBytes, { range: `bytes=0-${bytes - 1}` }),
      stream: async (path, bytes, limitBytes) => {
        const { data, whole } = await streamed(await ask(path, limitBytes), path, bytes, limitBytes);
        // A connection that broke behind the beginning: from the start.
        return { data, whole: whole.catch(() => get(path, limitBytes)) };
      },
    },
  };
}

/** Read the body of an answer; returns at its first `bytes` bytes, or at its end. */
async function streamed(
  response: Response,
  path: string,
  bytes: number,
  limitBytes: number,
): Promise<Streamed> {
  const reader = response.body!.getReader();
  const pieces: Uint8Array[] = [];
  let have = 0;
  const next = async (): Promise<boolean> => {
    const { value } = await reader.read();
    if (value === undefined) return false;
    have += value.length;
    if (have > limitBytes) throw tooLarge(path, limitBytes);
    pieces.push(value);
    return true;
  };
  const joined = (): Bytes => {
    const all = new Uint8Array(have);
    let at = 0;
    for (const piece of pieces) {
      all.set(piece, at);
      at += piece.length;
    }
    return all;
  };
  let more = true;
  while (more && have < bytes) more = await next();
  const data = joined().subarray(0, bytes);
  const rest = async (): Promise<Bytes> => {
    // Without a pause: answers that nobody reads would keep connections from files that are waited for.
    while (more) more = await next();
    return joined();
  };
  return { data, whole: rest() };
}

/** A zip archive at an address: read with range requests where the host supports them, else as a whole. */
async function remoteArchive(url: URL): Promise<FileSource> {
  const probe = await request(url, { range: "bytes=0-0" });
  const stated = /\/(\d+)$/.exec(probe.headers.get("content-range") ?? "");
  if (probe.status === 206 && stated !== null) {
    await probe.arrayBuffer();
    const read: RangeReader = async (start, length) => {
      if (length === 0) return new Uint8Array(0);
      const response = await request(url, { range: `bytes=${start}-${start + length - 1}` });
      if (response.status !== 206) {
        throw new BundleFault(
          "bundle.archive_damaged",
          fillIn(bundleFaults.rangesEnded, { address: url.href }),
        );
      }
      return new Uint8Array(await response.arrayBuffer());
    };
    return zipSource(await ZipArchive.open(read, Number(stated[1])));
  }
  if (!probe.ok) {
    if (probe.status !== 404) throw refusal(probe.status, url.pathname, url);
    throw new BundleFault("bundle.missing", fillIn(bundleFaults.nothingAt, { address: url.href }));
  }
  return zipSource(await ZipArchive.ofFile(await probe.blob()));
}

function zipSource(archive: ZipArchive): FileSource {
  return {
    paths: new Set(archive.entries.keys()),
    read: async (path, limitBytes) => {
      const entry = archive.entries.get(path);
      if (entry === undefined) throw missing(path);
      if (entry.sizeBytes > limitBytes) throw tooLarge(path, limitBytes);
      return archive.file(path);
    },
  };
}

function missing(path: string): BundleFault {
  if (path !== "manifest.json")
    return fetchAgain("bundle.file_missing", fillIn(bundleFaults.missing, { path }));
  return new BundleFault("bundle.manifest_missing", bundleFaults.manifestMissing);
}

/** Files of a folder that was dropped; the folder that holds manifest.json is the bundle. */
function droppedSource(files: ReadonlyMap<string, Blob>): FileSource {
  const manifest = [...files.keys()]
    .filter((path) => path === "manifest.json" || path.endsWith("/manifest.json"))
    .sort((a, b) => a.length - b.length)[0];
  if (manifest === undefined) throw missing("manifest.json");
  const root = manifest.slice(0, -"manifest.json".length);
  const inside = new Map(
    [...files]
      .filter(([path]) => path.startsWith(root))
      .map(([path, file]) => [path.slice(root.length), file]),
  );
  return {
    paths: new Set(inside.keys()),
    read: async (path, limitBytes) => {
      const file = inside.get(path);
      if (file === undefined) throw missing(path);
      if (file.size > limitBytes) throw tooLarge(path, limitBytes);
      return new Uint8Array(await file.arrayBuffer());
    },
  };
}
