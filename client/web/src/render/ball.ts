/** The sphere around a box. */
export type Ball = { readonly centre: readonly number[]; readonly radius: number };

export function ballOf(low: readonly number[], high: readonly number[]): Ball {
  const centre = low.map((value, axis) => 0.5 * (value + high[axis]!));
  return { centre, radius: 0.5 * Math.hypot(...low.map((value, axis) => high[axis]! - value)) };
}
