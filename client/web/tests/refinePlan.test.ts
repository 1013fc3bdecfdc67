import { describe, expect, it } from "vitest";
import { adaptedNote } from "../src/bundle/load.js";
import { NearestPoint } from "../src/refine/nearestPoint.js";
import { mostPixels, mostPoints, planOf } from "../src/refine/plan.js";
import { Randoms } from "../src/refine/randoms.js";
import { notRefining, statusText } from "../src/refine/status.js";

describe("finding a point", () => {
  it("finds the nearest one beside the surface, and one nearby far from it", () => {
    const randoms = new Randoms();
    randoms.begin(5, 0, 0);
    const points = Float32Array.from({ length: 3 * 2000 }, () => 0);
    for (let index = 0; index < 2000; index++) {
      const [z, angle] = [2 * randoms.next() - 1, 2 * Math.PI * randoms.next()];
      const radius = Math.sqrt(1 - z * z);
      points.set([radius * Math.cos(angle), radius * Math.sin(angle), 0.5 * z], 3 * index);
    }
    const finder = new NearestPoint(points);
    const away = (index: number, query: readonly number[]): number =>
      Math.hypot(...query.map((value, axis) => points[3 * index + axis]! - value));
    for (let index = 0; index < 60; index++) {
      const start = 3 * Math.floor(2000 * randoms.next());
      const near = [0, 1, 2].map((axis) => points[start + axis]! + 0.02 * (randoms.next() - 0.5));
      const far = [0, 1, 2].map(() => 6 * (randoms.next() - 0.5));
      const best = (query: readonly number[]): number => {
        let least = Number.POSITIVE_INFINITY;
        for (let other = 0; other < 2000; other++) least = Math.min(least, away(other, query));
        return least;
      };
      expect(away(finder.at(near[0]!, near[1]!, near[2]!), near)).toBeCloseTo(best(near), 6);
      expect(away(finder.at(far[0]!, far[1]!, far[2]!), far)).toBeLessThan(best(far) + 0.6);
    }
  });
});

describe("the plan of a picture", () => {
  it("is as fine as may be, and never finer than allowed", () => {
    expect(planOf(300, 200, 0.5, mostPoints.quick)).toEqual({ step: 1, samples: 2 });
    expect(planOf(1600, 1200, 0.2, mostPoints.quick)).toEqual({ step: 1, samples: 1 });
    for (const [width, height, covered] of [
      [3840, 2160, 0.5],
      [640, 480, 0.9],
      [100, 100, 0],
    ] as const) {
      const { step, samples } = planOf(width, height, covered, mostPoints.slow);
      expect((width / step) * (height / step) * covered * samples ** 2).toBeLessThanOrEqual(mostPoints.slow);
    }
  });
});

describe("the status", () => {
  it("says what happens, with the noise and what computes", () => {
    expect(statusText(notRefining)).toBe("");
    const running = { ...notRefining, phase: "running", backend: "webgpu", samplesPerPixel: 64 } as const;
    expect(statusText({ ...running, relativeError: 0.0234 })).toBe(
      "64 samples per pixel, noise 2.3%, by the trained cache on WebGPU…",
    );
    const slow = {
      ...running,
      phase: "done",
      backend: "wasm",
      note: "this browser offers no WebGPU",
    } as const;
    expect(statusText({ ...slow, relativeError: 0.01 })).toContain("no WebGPU");
    expect(statusText({ ...notRefining, phase: "failed", message: "no networks" })).toBe(
      "Cannot refine: no networks",
    );
  });
});

describe("caches that were adapted to a light", () => {
  it("are named where there are some, since they are not used", () => {
    const graph = (name: string, light: string) => ({ name, light });
    const manifest = (...graphs: { name: string; light: string }[]) =>
      ({ graphs, trainLights: ["sky"] }) as unknown as Parameters<typeof adaptedNote>[0];
    expect(adaptedNote(manifest(graph("fast_cache", "sky"), graph("gbuffer", "")))).toBe("");
    const note = adaptedNote(manifest(graph("fast_cache", "sky"), graph("fast_cache", "sunset")));
    expect(note).toContain("adapted to sunset");
    expect(statusText({ ...notRefining, phase: "running", backend: "webgpu", note })).toContain(note);
  });
});

describe("the resolution of a large picture that shows little", () => {
  it("is bounded by its pixels", () => {
    const { step, samples } = planOf(3840, 2160, 0.01, mostPoints.mesh);
    expect(samples).toBe(1);
    expect((3840 * 2160) / step ** 2).toBeLessThanOrEqual(mostPixels);
    expect(planOf(1920, 1080, 0.01, mostPoints.mesh)).toEqual({ step: 1, samples: 2 });
  });
});
