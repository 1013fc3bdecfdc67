/**
 * Repeatable random numbers: every point of every pass has its own sequence, independent of all other
 * computations.
 */

/** Fractional parts of multiples of these fill the unit square evenly (Roberts' R2 sequence). */
const evenSteps = [0.7548776662466927, 0.5698402909980532] as const;

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
    this.#state = (this.#state + 0x6d2b79f5) | 0;
    let x = Math.imul(this.#state ^ (this.#state >>> 15), this.#state | 1);
    x ^= x + Math.imul(x ^ (x >>> 7), x | 61);
    return ((x ^ (x >>> 14)) >>> 0) / 2 ** 32;
  }
}

/**
 * Write `count` triples of uniforms, evenly spread, to `out`. The first of a triple is stratified in rising order, so
 * that every sampling strategy gets consecutive elements of the sequence that the other two follow.
 */
export function evenUniforms(randoms: Randoms, count: number, out: Float64Array): void {
  const [first, second, third] = [randoms.next(), randoms.next(), randoms.next()];
  for (let index = 0; index < count; index++) {
    out[3 * index] = (index + first) / count;
    out[3 * index + 1] = (second + index * evenSteps[0]) % 1;
    out[3 * index + 2] = (third + index * evenSteps[1]) % 1;
  }
}
