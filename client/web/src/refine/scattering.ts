/**
 * Directions of incoming light by multiple importance sampling: `lambent_relight.refined.scattering`.
 *
 * Each direction comes from one of four strategies: light times the cosine, the cosine alone, the GGX lobe alone, light
 * times the mirror lobe. It is weighted by one over the density of their mixture: Veach's balance heuristic.
 */

import { baseReflectance, schlickWeight } from "../contract/reflectance.js";
import { cosineLobe, type LightSampler, lobeOfAlpha, tableRow } from "./lightSampler.js";
import { cosineSample, ggxSample, Reflection } from "./reflection.js";
import type { SurfacePoints } from "./surfacePoints.js";
import { mirrorOf, readVector, type Rotation, rotated, vector } from "./vectors.js";

/** Share of the diffuse lobe's directions that is drawn in proportion to the light as well. */
const diffuseLightShare = 0.8;
/** The same of the specular lobe, whose own density is the better guide the narrower it is. */
const specularLightShare = 0.3;
/** Found by experiment, as both shares are: docs/benchmarks/asset.md. */
const wideLobesGrazeLess = 3;

/** What a surface reflects towards the viewer, and of what light. */
export type Lit = {
  readonly meanAlbedo: number;
  readonly metalness: number;
  readonly alpha: number;
  /** Between the normal and the viewer. */
  readonly cosine: number;
  /** Means of the light under the cosine and under the mirror lobe, 1/sr. */
  readonly diffuseMean: number;
  readonly specularMean: number;
};

/**
 * Write the probability of every strategy, four numbers with the sum one. The lobes share the directions by what they
 * reflect if nothing is in the light's way; the specular one has a tenth at least, and 0.95 at most.
 */
export function strategyShares(lit: Lit, out: Float64Array): void {
  const { meanAlbedo, metalness, alpha, cosine } = lit;
  const f0 = baseReflectance(meanAlbedo, metalness);
  // Schlick's term at the mirror direction, less for wide lobes, which have few microfacets at that angle.
  const grazing = schlickWeight(Math.min(Math.max(cosine, 0), 1)) / (1 + wideLobesGrazeLess * alpha);
  const specular = cosine > 0 ? (f0 + (1 - f0) * grazing) * lit.specularMean : 0;
  const diffuse = (1 - metalness) * meanAlbedo * lit.diffuseMean;
  const share = Math.min(Math.max(specular / Math.max(specular + diffuse, 1e-9), 0.1), 0.95);
  out[0] = diffuseLightShare * (1 - share);
  out[1] = (1 - diffuseLightShare) * (1 - share);
  out[2] = (1 - specularLightShare) * share;
  out[3] = specularLightShare * share;
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

  /** Go to a point. */
  aim(point: number): void {
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
    const [normal, omegaO] = [this.#normal, this.#omegaO];
    strategyShares(
      {
        meanAlbedo: (red! + green! + blue!) / 3,
        metalness: points.metalness[point]!,
        alpha: this.#alpha,
        cosine: normal[0]! * omegaO[0]! + normal[1]! * omegaO[1]! + normal[2]! * omegaO[2]!,
        diffuseMean: this.light.mean(this.#cosineRow),
        specularMean: this.light.mean(this.#mirrorRow),
      },
      this.#shares,
    );
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
      const f0 = baseReflectance(base, metal);
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
