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

const wide = new Float32Array(1);
const bits = new Uint32Array(wide.buffer);

/** Return the half float nearest to a value, as its 16 bits; what is above 65504 becomes 65504. */
export function toHalf(value: number): number {
  wide[0] = Math.min(Math.max(value, -65504), 65504);
  const all = bits[0]!;
  const sign = (all >>> 16) & 0x8000;
  const exponent = ((all >>> 23) & 0xff) - 112;
  const fraction = all & 0x7fffff;
  if (exponent <= 0) {
    if (exponent < -10) return sign;
    const whole = fraction | 0x800000;
    const shift = 14 - exponent;
    const rounded = (whole >>> shift) + ((whole >>> (shift - 1)) & 1);
    return sign | rounded;
  }
  // A carry out of the fraction raises the exponent, as it should.
  return (sign | (exponent << 10) | (fraction >>> 13)) + ((fraction >>> 12) & 1);
}
