/** Deflated bytes, unpacked by the browser. */

/**
 * Return `numBytes` of what was packed, and the length of what was read: more, where that was found before the end.
 * Null for damaged bytes.
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
