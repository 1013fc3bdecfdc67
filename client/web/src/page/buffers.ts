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
