import { describe, expect, it } from "vitest";
import { Randoms } from "../src/refine/randoms.js";
import { drawSeeds, ranksOf, sobolElements } from "../src/refine/sobol.js";

function sequence(point: number, first: number, count: number): Float64Array {
  const [randoms, seeds] = [new Randoms(), new Uint32Array(6)];
  randoms.begin(1, 0, point);
  drawSeeds(randoms, seeds);
  const out = new Float64Array(3 * count);
  sobolElements(seeds, first, count, out);
  return out;
}

describe("the uniforms of a pixel", () => {
  it("are those of Python for the same seeds", () => {
    // lambent_relight.refined.sequence_kernels.write_elements, elements 5 and 6.
    const seeds = [0x01234567, 0x89abcdef, 0xfedcba98, 0x76543210, 0x00000001, 0xdeadbeef];
    const out = new Float64Array(6);
    sobolElements(Uint32Array.from(seeds), 5, 2, out);
    const expected = [0.076820324, 0.51255212, 0.653618676, 0.423671738, 0.388494982, 0.921232792];
    out.forEach((value, index) => {
      expect(value).toBeCloseTo(expected[index]!, 8);
    });
  });

  it("have one in every rectangle of a strategy's square, over one ray and over all", () => {
    for (let point = 0; point < 20; point++) {
      const u = sequence(point, 0, 16);
      for (const [wide, high] of [
        [1, 16],
        [4, 4],
        [16, 1],
      ] as const) {
        const cells = new Set<number>();
        for (let index = 0; index < 16; index++) {
          cells.add(Math.floor(wide * u[3 * index + 1]!) * high + Math.floor(high * u[3 * index + 2]!));
        }
        expect(cells.size).toBe(16);
      }
      const firsts = new Set(Array.from({ length: 16 }, (_, index) => Math.floor(16 * u[3 * index]!)));
      expect(firsts.size).toBe(16);
      const ray = sequence(point, 4, 4);
      expect(new Set([0, 1, 2, 3].map((index) => Math.floor(4 * ray[3 * index + 1]!))).size).toBe(4);
    }
  });

  it("are uniform over pixels", () => {
    const sums = [0, 0, 0];
    for (let point = 0; point < 3000; point++) {
      sequence(point, 3, 1).forEach((value, dimension) => {
        sums[dimension]! += value / 3000;
      });
    }
    for (const mean of sums) expect(Math.abs(mean - 0.5)).toBeLessThan(5 / Math.sqrt(12 * 3000));
  });

  it("are given to its rays in turn", () => {
    expect([...ranksOf(Uint32Array.of(7, 7, 3, 7, 3, 9))]).toEqual([0, 1, 0, 2, 1, 0]);
  });
});
