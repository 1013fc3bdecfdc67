import { describe, expect, it } from "vitest";
import { directionOfPixel, type Direction } from "../src/engine/environment.js";
import { prepareLight } from "../src/light/prepare.js";
import { groundUnder } from "../src/render/ground.js";
import { discDirections, groundLight, numSky, skyDirections } from "../src/render/groundLight.js";

const radians = Math.PI / 180;

describe("light on the ground", () => {
  it("comes from directions with density cosine / pi", () => {
    const all = skyDirections(numSky);
    const mean = (of: (d: Direction) => number): number => all.reduce((sum, d) => sum + of(d), 0) / numSky;
    for (const d of all) expect(Math.hypot(...d)).toBeCloseTo(1, 12);
    expect(mean((d) => d[2])).toBeCloseTo(2 / 3, 3);
    expect(mean((d) => d[2] ** 2)).toBeCloseTo(1 / 2, 3);
    expect(mean((d) => d[0] ** 2)).toBeCloseTo(1 / 4, 2);
    expect(Math.abs(mean((d) => d[0]))).toBeLessThan(0.01);
  });

  it("is pi times the radiance of an even sky, and adds lights above the horizon", () => {
    const coefficientsRgb = new Float64Array(27);
    const constant = Math.sqrt(0.25 / Math.PI);
    [1, 2, 3].forEach((radiance, channel) => {
      coefficientsRgb[channel] = radiance / constant;
    });
    const up: Direction = [0, 0.6, 0.8];
    const down: Direction = [0.6, 0, -0.8];
    const irradianceRgb = [
      [10, 20, 30],
      [5, 5, 5],
    ];
    const found = groundLight({ coefficientsRgb, bands: 3, directions: [up, down], irradianceRgb });
    const expected = [1, 2, 3].map((radiance) => Math.PI * radiance + 8 * radiance);
    found.wholeRgb.forEach((value, channel) => {
      expect(value).toBeCloseTo(expected[channel]!, 9);
    });
    expect(found.lightsRgb[1]).toEqual([0, 0, 0]);
  });

  it("never comes from below zero", () => {
    const coefficientsRgb = new Float64Array(27);
    coefficientsRgb[6] = 4;
    const { skyRgba, wholeRgb } = groundLight({
      coefficientsRgb,
      bands: 3,
      directions: [],
      irradianceRgb: [],
    });
    expect(Math.min(...skyRgba)).toBe(0);
    expect(wholeRgb[0]).toBeGreaterThan(0);
    expect(wholeRgb[1]).toBe(0);
  });
});

describe("the disc of a light", () => {
  it("is sampled inside its radius, above the ground only", () => {
    const centre: Direction = [Math.cos(40 * radians), 0, Math.sin(40 * radians)];
    const found = discDirections(centre, 3 * radians, 15);
    expect(found.length).toBe(15);
    for (const d of found) {
      const away = Math.acos(Math.min(1, d[0] * centre[0] + d[1] * centre[1] + d[2] * centre[2]));
      expect(away).toBeLessThan(3 * radians);
    }
    expect(discDirections([0, 0, 1], 0, 2)).toEqual([
      [0, 0, 1],
      [0, 0, 1],
    ]);
    const low: Direction = [Math.cos(radians), 0, Math.sin(radians)];
    expect(discDirections(low, 3 * radians, 15).length).toBeLessThan(15);
    expect(discDirections([0.6, 0, -0.8], 3 * radians, 15)).toEqual([]);
  });

  it.each([2, 3])("has the radius of a lamp of %i degrees in a map", (degrees) => {
    const [height, width] = [256, 512];
    const centre: Direction = [0, Math.cos(30 * radians), Math.sin(30 * radians)];
    const radianceRgb = new Float32Array(3 * height * width).fill(0.2);
    for (let row = 0; row < height; row++) {
      for (let column = 0; column < width; column++) {
        const d = directionOfPixel(row, column, height, width);
        const cosine = d[0] * centre[0] + d[1] * centre[1] + d[2] * centre[2];
        const start = 3 * (row * width + column);
        radianceRgb.fill(cosine > Math.cos(degrees * radians) ? 200 : 0.2, start, start + 3);
      }
    }
    const { lights, lightRadiiRad } = prepareLight({ height, width, radianceRgb }, 5, 4);
    expect(lights.length).toBe(1);
    expect(lightRadiiRad[0]! / radians).toBeGreaterThan(0.95 * degrees);
    expect(lightRadiiRad[0]! / radians).toBeLessThan(1.05 * degrees);
  });
});

describe("the ground", () => {
  it("lies under the box at the height that is asked for", () => {
    const { centre, height, reach } = groundUnder([-1, 0, -2], [1, 4, 2], -1.5);
    expect([centre, height]).toEqual([[0, 2], -1.5]);
    expect(reach).toBeCloseTo(2.5 * 3, 12);
  });
});
