/** Arrays of bytes: their digests, unpacking them, and handing them to workers. */

import { sha256 } from "@noble/hashes/sha2.js";
import { bytesToHex } from "@noble/hashes/utils.js";

/**
 * Return the SHA-256 of `data`, lower-case hexadecimal: by the browser, which offers no digests to pages over plain
 * HTTP, or by our own code.
 */
export async function sha256Hex(data: Uint8Array<ArrayBuffer>): Promise<string> {
  const subtle = globalThis.crypto?.subtle;
  return bytesToHex(subtle ? new Uint8Array(await subtle.digest("SHA-256", data)) : sha256(data));
}

/**
 * Return `numBytes` of deflated bytes, unpacked by the browser, and how many were read, which is more than `numBytes` if
 * there are more. Null for damaged bytes.
 */
export async function inflated(
  packed: Uint8Array<ArrayBuffer>,
  format: CompressionFormat,
  numBytes: number,
): Promise<{ bytes: Uint8Array<ArrayBuffer>; length: number } | null> {
  const reader = new Blob([packed]).stream().pipeThrough(new DecompressionStream(format)).getReader();
  const bytes = new Uint8Array(numBytes);
  let length = 0;
  try {
    for (let part = await reader.read(); !part.done && length <= numBytes; part = await reader.read()) {
      bytes.set(part.value.subarray(0, numBytes - length), length);
      length += part.value.length;
    }
  } catch {
    return null;
  } finally {
    void reader.cancel().catch(() => {});
  }
  return { bytes, length };
}

/** Return the buffers of the arrays in a plain value, each once, so that a worker can hand them over. */
export function buffersOf(value: unknown): ArrayBufferLike[] {
  if (ArrayBuffer.isView(value)) return [value.buffer];
  if (typeof value !== "object" || value === null) return [];
  return [...new Set(Object.values(value).flatMap(buffersOf))];
}

/** Return `buffersOf` a value and the pictures in it, each once. */
export function transferablesOf(value: unknown): Transferable[] {
  const pictures = new Set<ImageBitmap>();
  const collect = (part: unknown): void => {
    if (part instanceof ImageBitmap) pictures.add(part);
    else if (typeof part === "object" && part !== null && !ArrayBuffer.isView(part)) {
      Object.values(part).forEach(collect);
    }
  };
  collect(value);
  return [...(buffersOf(value) as ArrayBuffer[]), ...pictures];
}

/** Return a plain value with its arrays in memory that workers share instead of getting copies of it. */
export function sharedCopy<T>(value: T): T {
  if (ArrayBuffer.isView(value)) {
    const { buffer, byteOffset, byteLength } = value;
    const memory = new SharedArrayBuffer(byteLength);
    new Uint8Array(memory).set(new Uint8Array(buffer, byteOffset, byteLength));
    return new (value.constructor as new (memory: SharedArrayBuffer) => T)(memory);
  }
  if (Array.isArray(value)) return value.map(sharedCopy) as T;
  if (typeof value !== "object" || value === null) return value;
  return Object.fromEntries(Object.entries(value).map(([name, part]) => [name, sharedCopy(part)])) as T;
}
