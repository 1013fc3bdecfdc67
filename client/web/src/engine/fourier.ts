/** Fourier transforms of power-of-two length, in place, on separate real and imaginary parts. */

/** Transforms of one length; the tables are made once. */
export class Fourier {
  readonly #cosines: Float64Array;
  readonly #sines: Float64Array;

  /** Prepare transforms of `length` values; a power of two. */
  constructor(readonly length: number) {
    if (length < 2 || (length & (length - 1)) !== 0) throw new RangeError(`${length} is no power of two`);
    this.#cosines = Float64Array.from({ length: length / 2 }, (_, k) => Math.cos((2 * Math.PI * k) / length));
    this.#sines = Float64Array.from({ length: length / 2 }, (_, k) => Math.sin((2 * Math.PI * k) / length));
  }

  /** Replace x by sum_n x_n e^(-2 pi i k n / length). */
  forward(real: Float64Array, imaginary: Float64Array): void {
    const { length } = this;
    for (let i = 1, j = 0; i < length; i++) {
      let bit = length >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j ^= bit;
      if (i < j) {
        [real[i], real[j]] = [real[j]!, real[i]!];
        [imaginary[i], imaginary[j]] = [imaginary[j]!, imaginary[i]!];
      }
    }
    for (let half = 1; half < length; half *= 2) {
      const stride = length / (2 * half);
      for (let start = 0; start < length; start += 2 * half) {
        for (let k = 0; k < half; k++) {
          const cosine = this.#cosines[k * stride]!;
          const sine = -this.#sines[k * stride]!;
          const low = start + k;
          const high = low + half;
          const re = real[high]! * cosine - imaginary[high]! * sine;
          const im = real[high]! * sine + imaginary[high]! * cosine;
          real[high] = real[low]! - re;
          imaginary[high] = imaginary[low]! - im;
          real[low] = real[low]! + re;
          imaginary[low] = imaginary[low]! + im;
        }
      }
    }
  }
}
