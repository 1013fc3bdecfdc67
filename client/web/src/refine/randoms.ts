/**
 * Repeatable random numbers: every point of every pass has its own sequence, independent of all other
 * computations.
 */

function mixed(value: number): number {
  let x = value | 0;
  x = Math.imul(x ^ (x >>> 16), 0x7feb352d);
  x = Math.imul(x ^ (x >>> 15), 0x846ca68b);
  return (x ^ (x >>> 16)) >>> 0;
}

/** A sequence of uniform numbers in [0, 1). */
export class Randoms {
  #state = 0;

  /** Start the sequence of a point in a pass. */
  begin(seed: number, pass: number, point: number): void {
    this.#state = mixed(mixed(mixed(seed + 0x9e3779b9) + pass) + point);
  }

  /** Return the next number. */
  next(): number {
    return this.nextBits() / 2 ** 32;
  }

  /** Return the next 32 random bits. */
  nextBits(): number {
    this.#state = (this.#state + 0x6d2b79f5) | 0;
    let x = Math.imul(this.#state ^ (this.#state >>> 15), this.#state | 1);
    x ^= x + Math.imul(x ^ (x >>> 7), x | 61);
    return (x ^ (x >>> 14)) >>> 0;
  }
}
