import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { narrowCoupling, sampledCoupling } from "../src/engine/coupling.js";
import { splitDominantLights } from "../src/engine/dominantLights.js";
import { directionOfPixel, type Direction } from "../src/engine/environment.js";
import { energy, pixelSolidAngle, resized, type EnvironmentMap } from "../src/engine/environmentMap.js";
import { lookup, rotateAboutZ } from "./lookup.js";
import { basis, cosineFactors, project, rotate, rotateZ, type Matrix3 } from "../src/engine/harmonics.js";
import { levelWidth, type Prefiltered, prefilter, zonalMean } from "../src/engine/prefilter.js";
import { splitSum, splitSumTable } from "../src/engine/splitSum.js";

type Pixels = readonly (readonly (readonly number[])[])[];

// The same files are read by tests/conformance/test_golden_light.py.
function golden<T>(name: string): T {
  const file = new URL(`../../../tests/golden/light_${name}.json`, import.meta.url);
  return JSON.parse(readFileSync(file, "utf8")) as T;
}

function mapOf(pixels: Pixels): EnvironmentMap {
  return {
    height: pixels.length,
    width: pixels[0]?.length ?? 0,
    radianceRgb: Float32Array.from(pixels.flat(2)),
  };
}

function constantMap(height: number, width: number, value: number): EnvironmentMap {
  return { height, width, radianceRgb: new Float32Array(3 * height * width).fill(value) };
}

function expectClose(found: ArrayLike<number>, expected: ArrayLike<number>, tolerance = 1e-5): void {
  expect(found.length).toBe(expected.length);
  let worst = 0;
  for (let index = 0; index < found.length; index++) {
    const [a, b] = [found[index] ?? NaN, expected[index] ?? NaN];
    const error = Math.abs(a - b) / Math.max(1, Math.abs(b));
    // A comparison with NaN is false, so that NaN is not overlooked.
    if (!(error <= worst)) worst = error;
  }
  expect(worst).toBeLessThanOrEqual(tolerance);
}

describe("spherical harmonics", () => {
  const numbers = golden<{
    directions: Direction[];
    basis: number[][];
    map: Pixels;
    coefficients: number[][];
    rotate_deg: number;
    coefficients_turned: number[][];
    matrix: Matrix3;
    coefficients_rotated: number[][];
    cosine_factors: number[];
  }>("harmonics");

  it("has the golden basis", () => {
    numbers.directions.forEach((direction, index) => {
      expectClose(basis(direction, 7), numbers.basis[index] ?? []);
    });
  });

  it("projects a map to the golden coefficients, turned and straight", () => {
    const coefficients = project(mapOf(numbers.map), 7);
    expectClose(coefficients, numbers.coefficients.flat());
    expectClose(rotateZ(coefficients, 7, numbers.rotate_deg), numbers.coefficients_turned.flat());
    expectClose(rotate(coefficients, 7, numbers.matrix), numbers.coefficients_rotated.flat());
  });

  it("has the golden cosine factors", () => {
    expectClose(cosineFactors(7), numbers.cosine_factors);
  });

  it("puts a constant into band 0 only", () => {
    const coefficients = project(constantMap(6, 12, 0.5), 7);
    expectClose(
      coefficients.slice(0, 3),
      [1, 1, 1].map((one) => one * 0.5 * Math.sqrt(4 * Math.PI)),
    );
    expectClose(coefficients.slice(3), new Float64Array(coefficients.length - 3));
  });
});

/** Return radiance in a direction for a perceptual roughness, linear between levels. */
function lookupLevels(levels: Prefiltered, direction: Direction, roughness: number): number[] {
  const place = roughness * (levels.length - 1);
  const index = Math.min(Math.floor(place), levels.length - 2);
  const [sharp, rough] = [lookup(levels[index]!, direction), lookup(levels[index + 1]!, direction)];
  return sharp.map((value, channel) => value + (place - index) * (rough[channel]! - value));
}

describe("prefiltered levels", () => {
  const numbers = golden<{
    map: Pixels;
    num_levels: number;
    rotate_deg: number;
    level_widths: number[];
    directions: Direction[];
    perceptual_roughness: number[];
    radiance: number[][];
  }>("prefilter");
  const levels = prefilter(mapOf(numbers.map), numbers.num_levels);

  it("have the golden sizes and radiance", () => {
    expect(levels.map((level) => level.width)).toEqual(numbers.level_widths);
    numbers.directions.forEach((direction, index) => {
      const roughness = numbers.perceptual_roughness[index] ?? NaN;
      const found = lookupLevels(levels, rotateAboutZ(direction, -numbers.rotate_deg), roughness);
      expectClose(found, numbers.radiance[index] ?? [], 1e-4);
    });
  });

  it("keep a constant and start with the map itself", () => {
    for (const level of prefilter(constantMap(4, 8, 0.7), 4)) {
      expectClose(level.radianceRgb, new Float64Array(level.radianceRgb.length).fill(0.7), 1e-6);
    }
    expect(levels[0]?.radianceRgb).toEqual(mapOf(numbers.map).radianceRgb);
    expect(levelWidth(1 / 64)).toBe(512);
    expect(() => prefilter(constantMap(4, 8, 1), 1)).toThrow(RangeError);
  });

  it("of a narrow lobe are the same from a formula", () => {
    const alpha = 1 / 64;
    const [height, width] = [64, 128];
    const radianceRgb = Float32Array.from(
      { length: 3 * height * width },
      (_, at) => 0.5 + 0.5 * Math.sin(at ** 1.3),
    );
    // A sun, whose faint far ends must be right too.
    radianceRgb.fill(1e4, 3 * (20 * width + 30), 3 * (20 * width + 31));
    const map = { height, width, radianceRgb };
    const wanted = zonalMean(map, sampledCoupling(alpha, width)).radianceRgb;
    const found = zonalMean(map, narrowCoupling(alpha, width)).radianceRgb;
    expectClose(found, wanted, 1e-4);
  });

  it("are sums over the kernel's values", () => {
    const map = mapOf(numbers.map);
    const fine = resized(map, 8, 16);
    const alpha = 0.5;
    const found = zonalMean(fine, sampledCoupling(alpha, 16)).radianceRgb;
    const directions = Array.from({ length: 128 }, (_, at) => directionOfPixel(at >> 4, at & 15, 8, 16));
    directions.forEach((direction, at) => {
      const sum = [0, 0, 0, 0];
      directions.forEach((other, from) => {
        const cosine = direction.reduce((total, value, axis) => total + value * other[axis]!, 0);
        const spread = 0.5 * (1 + cosine) * alpha ** 2 + 0.5 * (1 - cosine);
        const weight = (pixelSolidAngle(from >> 4, 8, 16) * Math.max(cosine, 0)) / spread ** 2;
        const pixel = [...fine.radianceRgb.slice(3 * from, 3 * from + 3), 1];
        pixel.forEach((value, part) => {
          sum[part]! += weight * value;
        });
      });
      const mean = sum.slice(0, 3).map((value) => value / sum[3]!);
      expectClose(found.slice(3 * at, 3 * at + 3), mean, 1e-9);
    });
  });

  it("are made from means that keep the energy", () => {
    const map = mapOf(numbers.map);
    expectClose(energy(resized(map, 3, 5)), energy(map), 1e-9);
    expectClose(resized(map, 8, 16).radianceRgb, map.radianceRgb, 1e-9);
  });
});

describe("split sum", () => {
  it("has the golden values", () => {
    const numbers = golden<{
      inputs: [number, number][];
      scale: number[];
      bias: number[];
      table_corner: number[][];
    }>("split_sum");
    const table = splitSumTable();
    numbers.inputs.forEach(([cosine, roughness], index) => {
      const { scale, bias } = splitSum(table, cosine, roughness);
      expectClose([scale, bias], [numbers.scale[index] ?? NaN, numbers.bias[index] ?? NaN]);
    });
    const corners = [0, 31, 31 * 32, 31 * 32 + 31].map((entry) =>
      Array.from(table.slice(2 * entry, 2 * entry + 2)),
    );
    expectClose(corners.flat(), numbers.table_corner.flat());
  });
});

describe("dominant lights", () => {
  const numbers = golden<{
    map: Pixels;
    directions: Direction[];
    radiance_solid_angle: number[][];
    residual_energy: number[];
    residual_rows: number[];
  }>("dominant");
  const map = mapOf(numbers.map);
  const { lights, residual } = splitDominantLights(map, 3);

  it("are the golden ones", () => {
    expect(lights.length).toBe(numbers.directions.length);
    expectClose(
      lights.flatMap((light) => [...light.direction]),
      numbers.directions.flat(),
    );
    expectClose(
      lights.flatMap((light) => light.radianceSolidAngle),
      numbers.radiance_solid_angle.flat(),
    );
    expectClose(energy(residual), numbers.residual_energy);
    const rows = numbers.residual_rows.map((_, row) =>
      Array.from(residual.radianceRgb.slice(3 * row * map.width, 3 * (row + 1) * map.width)).reduce(
        (a, b) => a + b,
      ),
    );
    expectClose(rows, numbers.residual_rows);
  });

  it("keep the energy", () => {
    const together = energy(residual).map((value, channel) =>
      lights.reduce((sum, light) => sum + (light.radianceSolidAngle[channel] ?? NaN), value),
    );
    expectClose(together, energy(map), 1e-6);
  });

  it("do not exist in an even map", () => {
    expect(splitDominantLights(constantMap(8, 16, 1), 3).lights).toEqual([]);
    expect(splitDominantLights(constantMap(1, 1, 1), 3).lights).toEqual([]);
  });
});

describe("maps", () => {
  it("are looked up bilinearly, with solid angles that fill the sphere", () => {
    const map = mapOf(golden<{ map: Pixels }>("harmonics").map);
    expectClose(lookup(map, directionOfPixel(3, 5, 8, 16)), map.radianceRgb.slice(3 * 53, 3 * 54), 1e-6);
    const rows = Array.from({ length: 8 }, (_, index) => 16 * pixelSolidAngle(index, 8, 16));
    expect(rows.reduce((a, b) => a + b)).toBeCloseTo(4 * Math.PI, 10);
  });
});
