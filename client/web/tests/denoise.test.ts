import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import type { RefinedPicture } from "../src/refine/accumulation.js";
import { denoised, type PixelFeatures } from "../src/refine/denoise.js";

type Layer = "direct" | "indirect" | "visibility";
type Golden = { width: number; height: number; out: Record<Layer, number[]> } & Record<
  Layer | "standard_error" | "albedo" | "normal" | "distance" | "coverage",
  number[]
>;

// Written by Python: tests/support/golden_denoising.py.
const file = new URL("../../../tests/golden/denoising.json", import.meta.url);
const golden = JSON.parse(readFileSync(file, "utf8")) as Golden;
const features: PixelFeatures = {
  albedo: Float32Array.from(golden.albedo),
  normal: Float32Array.from(golden.normal),
  distance: Float32Array.from(golden.distance),
};
const noisy: RefinedPicture = {
  width: golden.width,
  height: golden.height,
  directRgb: Float32Array.from(golden.direct),
  indirectRgb: Float32Array.from(golden.indirect),
  standardErrorRgb: Float32Array.from(golden.standard_error),
  visibility: Float32Array.from(golden.visibility),
  coverage: Float32Array.from(golden.coverage),
  samplesPerPixel: 8,
  relativeError: 0.1,
};

describe("smoothing a refined picture", () => {
  it("is what Python does", async () => {
    const { directRgb, indirectRgb, visibility } = await denoised(noisy, features);
    for (const [found, wanted] of [
      [directRgb, golden.out.direct],
      [indirectRgb, golden.out.indirect],
      [visibility, golden.out.visibility],
    ] as const) {
      found.forEach((value, index) => {
        expect(Math.abs(value - wanted[index]!)).toBeLessThan(2e-6 + 3e-5 * Math.abs(wanted[index]!));
      });
    }
  });

  it("changes nothing where there is no noise, and leaves its input alone", async () => {
    const before = noisy.directRgb.slice();
    const quiet = { ...noisy, standardErrorRgb: new Float32Array(noisy.standardErrorRgb.length) };
    const { directRgb } = await denoised(quiet, features);
    directRgb.forEach((value, index) => {
      expect(value).toBeCloseTo(before[index]!, 3);
    });
    expect(noisy.directRgb).toEqual(before);
  });
});
