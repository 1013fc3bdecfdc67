/** A curve over time as coordinates in a box; drawing it is left to the caller. */

import type { Sample } from "./store.js";

type Chart = {
  /** Pairs of x and y, joined. */
  readonly points: string;
  readonly lowest: number;
  readonly highest: number;
  /** Seconds between the first and the last sample. */
  readonly spanS: number;
};

const margin = 2;

/** Return at most `count` samples: first, last, and those between at equal distances. */
export function thinned(samples: readonly Sample[], count: number): readonly Sample[] {
  if (samples.length <= count) return samples;
  const last = samples.length - 1;
  return Array.from({ length: count }, (_, place) => samples[Math.round((place * last) / (count - 1))]!);
}

/**
 * Return the curve of samples in a box of `width` x `height`, the largest value at the top.
 *
 * With `logarithmic` the height is that of the logarithm, as for a loss, which falls by factors. Null for fewer than
 * two samples.
 */
export function chart(
  samples: readonly Sample[],
  width: number,
  height: number,
  logarithmic = false,
): Chart | null {
  if (samples.length < 2) return null;
  const scale = (value: number) => (logarithmic ? Math.log(value) : value);
  const values = samples.map((sample) => sample.value);
  const [lowest, highest] = [Math.min(...values), Math.max(...values)];
  const from = samples[0]!.atS;
  const spanS = samples.at(-1)!.atS - from;
  const range = scale(highest) - scale(lowest) || 1;
  const points = samples.map(({ atS, value }) => {
    const x = ((atS - from) / (spanS || 1)) * width;
    const y = margin + (height - 2 * margin) * ((scale(highest) - scale(value)) / range);
    return `${x.toFixed(2)},${y.toFixed(2)}`;
  });
  return { points: points.join(" "), lowest, highest, spanS };
}
