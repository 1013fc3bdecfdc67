/** Half floats: textures keep light in them. */

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
