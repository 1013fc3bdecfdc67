/** Compressed copies of built files, so that a server need not compress them for each request. */

import { readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { brotliCompressSync, constants, gzipSync } from "node:zlib";
import type { Plugin } from "vite";

const COMPRESSIBLE = /\.(css|html|js|json|mjs|svg|wasm)$/;
// A smaller file fits into the first packet as it is.
const LEAST_BYTES = 512;
// The last two brotli levels take half a minute for the 14 MB of WebAssembly and save another 8 % of them.
const LARGE_BYTES = 4 << 20;

/** Return the encodings of a file's content that are smaller than it, by the suffix of their file. */
export function compressed(content: Buffer): ReadonlyMap<string, Buffer> {
  if (content.length < LEAST_BYTES) return new Map();
  const quality = content.length > LARGE_BYTES ? 9 : 11;
  const params = {
    [constants.BROTLI_PARAM_QUALITY]: quality,
    [constants.BROTLI_PARAM_SIZE_HINT]: content.length,
  };
  const made = [
    [".br", brotliCompressSync(content, { params })],
    [".gz", gzipSync(content, { level: 9 })],
  ] as const;
  return new Map(made.filter(([, bytes]) => bytes.length < content.length));
}

/** Write NAME.br and NAME.gz beside each text and program in the output folder. */
export function precompress(): Plugin {
  let folder = "";
  return {
    name: "precompress",
    apply: "build",
    configResolved(config) {
      folder = config.build.outDir;
    },
    closeBundle() {
      for (const name of readdirSync(folder, { recursive: true, encoding: "utf8" })) {
        const path = join(folder, name);
        if (!COMPRESSIBLE.test(name) || !statSync(path).isFile()) continue;
        for (const [suffix, bytes] of compressed(readFileSync(path))) writeFileSync(path + suffix, bytes);
      }
    },
  };
}
