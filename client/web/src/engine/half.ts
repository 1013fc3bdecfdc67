/** Half-precision numbers (IEEE 754 binary16). */

/** Return the value of a half given as its 16 bits. */
export function halfValue(bits: number): number {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 31) return fraction === 0 ? sign * Number.POSITIVE_INFINITY : Number.NaN;
  return exponent === 0 ? sign * fraction * 2 ** -24 : sign * (1024 + fraction) * 2 ** (exponent - 25);
}

let table: Float32Array | null = null;

/** Return the values of all 65536 halves by their bits. */
export function halfTable(): Float32Array {
  table ??= Float32Array.from({ length: 0x10000 }, (_, bits) => halfValue(bits));
  return table;
}

/** Return the bytes of little-endian halves as those of little-endian float32 numbers. */
export function widenedHalves(bytes: Uint8Array): Uint8Array<ArrayBuffer> {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const values = halfTable();
  const wide = new DataView(new ArrayBuffer(bytes.byteLength * 2));
  for (let at = 0; at < bytes.byteLength; at += 2) {
    wide.setFloat32(2 * at, values[view.getUint16(at, true)]!, true);
  }
  return new Uint8Array(wide.buffer);
}
