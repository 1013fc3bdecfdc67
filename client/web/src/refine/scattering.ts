/**
 * Directions of incoming light by multiple importance sampling: `lambent_relight.refined.scattering`.
 *
 * Each direction comes from one of four strategies: light times the cosine, the cosine alone, the GGX lobe alone, light
 * times the mirror lobe. It is weighted by one over the density of their mixture: Veach's balance heuristic.
 */

import { cosineLobe, type LightSampler, lobeOfAlpha, tableRow } from "./lightSampler.js";
import { cosineSample, dielectricF0, ggxSample, Reflection } from "./reflection.js";
import type { SurfacePoints } from "./surfacePoints.js";
import { mirrorOf, readVector, type Rotation, rotated, vector } from "./vectors.js";

/** Share of each lobe's directions that is drawn in proportion to the light as well. */
const lightShare = 0.6;

/** Write the probability of every strategy for a surface, four numbers with the sum one. */
export function strategyShares(meanAlbedo: number, metalness: number, out: Float64Array): void {
  const specular = metalness * meanAlbedo + (1 - metalness) * dielectricF0;
  const diffuse = (1 - metalness) * meanAlbedo;
  const share = Math.min(Math.max(specular / Math.max(specular + diffuse, 1e-6), 0.1), 0.95);
  out[0] = lightShare * (1 - share);
  out[1] = (1 - lightShare) * (1 - share);
  out[2] = (1 - lightShare) * share;
  out[3] = lightShare * share;
}

/**
 * Round shares so that `count` directions of a point divide without rest: a fixed number of directions for every
 * strategy has less variance than a random one. Fewer than three are left to chance.
 */
export function wholeShares(shares: Float64Array, count: number): void {
  if (count < 3) return;
  let [sum, before] = [0, 0];
  for (let index = 0; index < 4; index++) {
    sum += shares[index]!;
    const end = index === 3 ? count : Math.round(sum * count);
    shares[index] = (end - before) / count;
    before = end;
  }
}

/** Draws directions for the points of a picture under one light. */
export class Scattering {
  /** The direction that was drawn. */
  readonly omegaI = vector();
  /** BRDF times cosine over density, both lobes: times radiance an unbiased estimate. */
  readonly weight = vector();
  /** cos / pi over density: times visibility an estimate of the cosine-weighted share that is free. */
  openWeight = 0;
  readonly #reflection = new Reflection();
  readonly #normal = vector();
  readonly #omegaO = vector();
  readonly #mirror = vector();
  readonly #inMap = vector();
  readonly #shares = new Float64Array(4);
  #cosineRow = 0;
  #mirrorRow = 0;
  #alpha = 1;
  #point = 0;

  /** `turn` takes directions of the light's map to the world. */
  constructor(
    private readonly points: SurfacePoints,
    private readonly light: LightSampler,
    private readonly turn: Rotation,
  ) {}

  /** Go to a point of which `count` directions will be drawn. */
  aim(point: number, count: number): void {
    const { points } = this;
    this.#point = point;
    readVector(points.normal, point, this.#normal);
    readVector(points.omegaO, point, this.#omegaO);
    this.#alpha = points.alpha[point]!;
    mirrorOf(this.#normal, this.#omegaO, this.#mirror);
    rotated(this.turn, this.#normal, this.#inMap, true);
    this.#cosineRow = tableRow(this.#inMap, cosineLobe);
    rotated(this.turn, this.#mirror, this.#inMap, true);
    this.#mirrorRow = tableRow(this.#inMap, lobeOfAlpha(this.#alpha));
    const [red, green, blue] = [0, 1, 2].map((channel) => points.albedo[3 * point + channel]!);
    strategyShares((red! + green! + blue!) / 3, points.metalness[point]!, this.#shares);
    wholeShares(this.#shares, count);
  }

  /** Draw a direction from three uniforms; false where it lies below the surface and contributes nothing. */
  draw(u0: number, u1: number, u2: number): boolean {
    const shares = this.#shares;
    const { omegaI } = this;
    if (u0 < shares[0]!) this.#fromLight(u1, u2, this.#cosineRow);
    else if (u0 < shares[0]! + shares[1]!) cosineSample(u1, u2, this.#normal, omegaI);
    else if (u0 < shares[0]! + shares[1]! + shares[2]!) {
      ggxSample(u1, u2, this.#omegaO, this.#normal, this.#alpha, omegaI);
    } else this.#fromLight(u1, u2, this.#mirrorRow);
    const normal = this.#normal;
    const cosine = normal[0]! * omegaI[0]! + normal[1]! * omegaI[1]! + normal[2]! * omegaI[2]!;
    if (!(cosine > 0)) return false;
    const pdf = this.pdf();
    if (!(pdf > 0)) return false;
    const { albedo, metalness } = this.points;
    const metal = metalness[this.#point]!;
    const { cosinePdf, specular, grazing } = this.#reflection;
    for (let channel = 0; channel < 3; channel++) {
      const base = albedo[3 * this.#point + channel]!;
      const f0 = metal * base + (1 - metal) * dielectricF0;
      this.weight[channel] =
        ((1 - metal) * base * cosinePdf + f0 * specular + grazing) / Math.max(pdf, 1e-20);
    }
    this.openWeight = cosinePdf / Math.max(pdf, 1e-20);
    return true;
  }

  /** Return the density of `draw` at `omegaI`, 1/sr. */
  pdf(): number {
    const shares = this.#shares;
    this.#reflection.set(this.#omegaO, this.omegaI, this.#normal, this.#alpha);
    rotated(this.turn, this.omegaI, this.#inMap, true);
    const pixel = this.light.pixelOf(this.#inMap);
    return (
      shares[0]! * this.light.density(this.#cosineRow, pixel) +
      shares[1]! * this.#reflection.cosinePdf +
      shares[2]! * this.#reflection.ggxPdf +
      shares[3]! * this.light.density(this.#mirrorRow, pixel)
    );
  }

  #fromLight(u1: number, u2: number, row: number): void {
    this.light.sample(u1, u2, row, this.#inMap);
    rotated(this.turn, this.#inMap, this.omegaI);
  }
}
