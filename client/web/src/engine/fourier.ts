/** Fourier transforms of power-of-two length, in place, on separate real and imaginary parts. */

/** Transforms of one length; the tables are made once. */
export class Fourier {
  readonly #cosines: Float64Array;
  readonly #sines: Float64Array;
  /** Pairs of places that change places before the first step. */
  readonly #swaps: Uint32Array;

  /** Prepare transforms of `length` values; a power of two. */
  constructor(readonly length: number) {
    if (length < 2 || (length & (length - 1)) !== 0) throw new RangeError(`${length} is not a power of two`);
    this.#cosines = Float64Array.from({ length: length / 2 }, (_, k) => Math.cos((2 * Math.PI * k) / length));
    this.#sines = Float64Array.from({ length: length / 2 }, (_, k) => Math.sin((2 * Math.PI * k) / length));
    const swaps: number[] = [];
    for (let i = 1, j = 0; i < length; i++) {
      let bit = length >> 1;
      for (; j & bit; bit >>= 1) j ^= bit;
      j ^= bit;
      if (i < j) swaps.push(i, j);
    }
    this.#swaps = Uint32Array.from(swaps);
  }

  /** Replace x by sum_n x_n e^(-2 pi i k n / length). */
  forward(real: Float64Array, imaginary: Float64Array): void {
    const { length } = this;
    const swaps = this.#swaps;
    const cosines = this.#cosines;
    const sines = this.#sines;
    for (let place = 0; place < swaps.length; place += 2) {
      const [i, j] = [swaps[place]!, swaps[place + 1]!];
      [real[i], real[j]] = [real[j]!, real[i]!];
      [imaginary[i], imaginary[j]] = [imaginary[j]!, imaginary[i]!];
    }
    for (let half = 1; half < length; half *= 2) {
      const stride = length / (2 * half);
      for (let start = 0; start < length; start += 2 * half) {
        for (let k = 0; k < half; k++) {
          const cosine = cosines[k * stride]!;
          const sine = -sines[k * stride]!;
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

/**
 * Transforms of even sequences, which are real: F_k = f_0 + (-1)^k f_N + 2 sum_(0<j<N) f_j cos(pi j k / N).
 *
 * Half a sequence, N + 1 values, takes a real transform of N values, and two of those go through one complex one.
 */
export class EvenFourier {
  readonly #half: Fourier;
  readonly #real: Float64Array;
  readonly #imaginary: Float64Array;
  readonly #cosines: Float64Array;
  readonly #sines: Float64Array;

  /** Prepare transforms of sequences of N + 1 values; N is a power of two. */
  constructor(readonly last: number) {
    this.#half = new Fourier(last);
    this.#real = new Float64Array(last);
    this.#imaginary = new Float64Array(last);
    this.#cosines = Float64Array.from({ length: last }, (_, j) => Math.cos((Math.PI * j) / last));
    this.#sines = Float64Array.from({ length: last }, (_, j) => Math.sin((Math.PI * j) / last));
  }

  /** Replace two sequences by their transforms. */
  forward(first: Float64Array, second: Float64Array): void {
    const n = this.last;
    const real = this.#real;
    const imaginary = this.#imaginary;
    const oddOfFirst = this.#fold(first, real);
    const oddOfSecond = this.#fold(second, imaginary);
    this.#half.forward(real, imaginary);
    let odd1 = 2 * oddOfFirst;
    let odd2 = 2 * oddOfSecond;
    first[0] = 2 * real[0]!;
    second[0] = 2 * imaginary[0]!;
    first[1] = odd1;
    second[1] = odd2;
    for (let k = 1; k < n / 2; k++) {
      const re = real[k]!;
      const im = imaginary[k]!;
      const mirroredRe = real[n - k]!;
      const mirroredIm = imaginary[n - k]!;
      first[2 * k] = re + mirroredRe;
      second[2 * k] = im + mirroredIm;
      odd1 += mirroredIm - im;
      odd2 += re - mirroredRe;
      first[2 * k + 1] = odd1;
      second[2 * k + 1] = odd2;
    }
    first[n] = 2 * real[n / 2]!;
    second[n] = 2 * imaginary[n / 2]!;
  }

  /** Fold a sequence onto N values, and return half of F_1. */
  #fold(values: Float64Array, into: Float64Array): number {
    const n = this.last;
    const cosines = this.#cosines;
    const sines = this.#sines;
    into[0] = 0.5 * (values[0]! + values[n]!);
    let odd = 0.5 * (values[0]! - values[n]!);
    for (let j = 1; j < n; j++) {
      const here = values[j]!;
      const there = values[n - j]!;
      into[j] = 0.5 * (here + there) - sines[j]! * (here - there);
      odd += here * cosines[j]!;
    }
    return odd;
  }
}
