/** Means and standard errors over passes, as a picture. */

import type { PassMeans } from "./passes.js";
import type { SurfacePoints } from "./surfacePoints.js";

/** A refined picture: linear radiance, rows from the top, not multiplied by coverage. */
export type RefinedPicture = {
  readonly width: number;
  readonly height: number;
  readonly directRgb: Float32Array<ArrayBuffer>;
  readonly indirectRgb: Float32Array<ArrayBuffer>;
  /** Of `directRgb` + `indirectRgb`. */
  readonly standardErrorRgb: Float32Array<ArrayBuffer>;
  /** Cosine-weighted share of free directions. */
  readonly visibility: Float32Array<ArrayBuffer>;
  /** Share of a pixel that shows the object. */
  readonly coverage: Float32Array<ArrayBuffer>;
  /** Directions of a pixel that is covered whole. */
  readonly samplesPerPixel: number;
  /** Mean standard error of a pixel over mean radiance. */
  readonly relativeError: number;
};

/** Sums over passes. */
export class Accumulation {
  numPasses = 0;
  readonly #direct: Float32Array;
  readonly #indirect: Float32Array;
  readonly #visibility: Float32Array;
  readonly #squares: Float32Array;

  /** `samples` x `samples` points make a pixel. */
  constructor(
    private readonly points: SurfacePoints,
    private readonly size: { readonly width: number; readonly height: number },
    private readonly samples: number,
  ) {
    this.#direct = new Float32Array(3 * points.count);
    this.#indirect = new Float32Array(3 * points.count);
    this.#squares = new Float32Array(3 * points.count);
    this.#visibility = new Float32Array(points.count);
  }

  /** Add an independent pass. */
  add({ directRgb, indirectRgb, visibility }: PassMeans): void {
    this.numPasses++;
    for (let index = 0; index < directRgb.length; index++) {
      const value = directRgb[index]! + indirectRgb[index]!;
      this.#direct[index]! += directRgb[index]!;
      this.#indirect[index]! += indirectRgb[index]!;
      this.#squares[index]! += value * value;
    }
    visibility.forEach((value, point) => {
      this.#visibility[point]! += value;
    });
  }

  /** Return the mean of all passes, at least two, of `perPass` directions each. */
  picture(perPass: number): RefinedPicture {
    const { points, samples, numPasses } = this;
    const { width, height } = this.size;
    const numPixels = width * height;
    const rgb = (): Float32Array<ArrayBuffer> => new Float32Array(3 * numPixels);
    const [directRgb, indirectRgb, standardErrorRgb] = [rgb(), rgb(), rgb()];
    const [visibility, coverage] = [new Float32Array(numPixels), new Float32Array(numPixels)];
    let [errors, radiance] = [0, 0];
    for (let point = 0; point < points.count; point++) {
      const pixel = points.pixel[point]!;
      coverage[pixel]! += 1;
      visibility[pixel]! += this.#visibility[point]! / numPasses;
      for (let channel = 0; channel < 3; channel++) {
        const [from, to] = [3 * point + channel, 3 * pixel + channel];
        const [direct, indirect] = [this.#direct[from]! / numPasses, this.#indirect[from]! / numPasses];
        const mean = direct + indirect;
        const variance = Math.max(this.#squares[from]! / numPasses - mean * mean, 0) / (numPasses - 1);
        directRgb[to]! += direct;
        indirectRgb[to]! += indirect;
        standardErrorRgb[to]! += variance;
        errors += Math.sqrt(variance);
        radiance += mean;
      }
    }
    for (let index = 0; index < 3 * numPixels; index++) {
      const count = Math.max(coverage[Math.floor(index / 3)]!, 1);
      directRgb[index]! /= count;
      indirectRgb[index]! /= count;
      standardErrorRgb[index] = Math.sqrt(standardErrorRgb[index]!) / count;
    }
    for (let pixel = 0; pixel < numPixels; pixel++) {
      visibility[pixel]! /= Math.max(coverage[pixel]!, 1);
      coverage[pixel]! /= samples * samples;
    }
    return {
      width,
      height,
      directRgb,
      indirectRgb,
      standardErrorRgb,
      visibility,
      coverage,
      samplesPerPixel: numPasses * perPass * samples * samples,
      relativeError: radiance > 0 ? errors / samples / radiance : 0,
    };
  }
}
