/** Half-precision numbers (IEEE 754 binary16). */

/** Return the value of a half given as its 16 bits. */
export function halfValue(bits: number): number {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 31) return fraction === 0 ? sign * Number.POSITIVE_INFINITY : Number.NaN;
  return exponent === 0 ? sign * fraction * 2 ** -24 : sign * (1024 + fraction) * 2 ** (exponent - 25);
}

/** Return the bytes of little-endian halves as those of little-endian float32 numbers. */
export function widenedHalves(bytes: Uint8Array): Uint8Array<ArrayBuffer> {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const table = new Float32Array(65536);
  for (let bits = 0; bits < 65536; bits++) table[bits] = halfValue(bits);
  const wide = new DataView(new ArrayBuffer(bytes.byteLength * 2));
  for (let at = 0; at < bytes.byteLength; at += 2) {
    wide.setFloat32(2 * at, table[view.getUint16(at, true)]!, true);
  }
  return new Uint8Array(wide.buffer);
}
