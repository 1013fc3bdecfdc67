/** Curves over time as coordinates in a box; drawing them is left to the caller. */

import type { Sample } from "./store.js";

/** Points of one stage: pairs of x and y, joined. */
export type Curve = { readonly stage: string; readonly points: string };

export type Chart = {
  readonly curves: readonly Curve[];
  readonly lowest: number;
  readonly highest: number;
  /** Seconds between the first and the last sample. */
  readonly spanS: number;
};

const margin = 2;

/** Return at most `count` samples of each stage: first, last, and those between at equal distances. */
export function thinned(samples: readonly Sample[], count: number): Sample[] {
  const stages = [...new Set(samples.map((sample) => sample.stage))];
  return stages.flatMap((stage) => {
    const mine = samples.filter((sample) => sample.stage === stage);
    if (mine.length <= count) return mine;
    const last = mine.length - 1;
    return Array.from({ length: count }, (_, place) => mine[Math.round((place * last) / (count - 1))]!);
  });
}

/**
 * Return the curves of samples in a box of `width` x `height`, the largest value at the top.
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
  const times = samples.map((sample) => sample.atS);
  const [from, to] = [Math.min(...times), Math.max(...times)];
  const span = to - from || 1;
  const range = scale(highest) - scale(lowest) || 1;
  const x = (atS: number) => ((atS - from) / span) * width;
  const y = (value: number) => margin + (height - 2 * margin) * ((scale(highest) - scale(value)) / range);
  const byStage = new Map<string, string[]>();
  for (const { stage, atS, value } of samples) {
    const points = byStage.get(stage) ?? [];
    points.push(`${x(atS).toFixed(2)},${y(value).toFixed(2)}`);
    byStage.set(stage, points);
  }
  const curves = [...byStage].map(([stage, points]) => ({ stage, points: points.join(" ") }));
  return { curves, lowest, highest, spanS: to - from };
}
