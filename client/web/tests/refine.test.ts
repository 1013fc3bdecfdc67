import { describe, expect, it, vi } from "vitest";
import { dielectricF0 } from "../src/contract/constants.js";
import { directionOfUv } from "../src/engine/environment.js";
import { pixelSolidAngle } from "../src/engine/environmentMap.js";
import { toHalf } from "../src/engine/half.js";
import { Accumulation } from "../src/refine/accumulation.js";
import type { Hits } from "../src/refine/hitRadiance.js";
import { cosineLobe, LightSampler, lobeOfAlpha, pixelMasses, tableRow } from "../src/refine/lightSampler.js";
import { onePass } from "../src/refine/passes.js";
import { Randoms } from "../src/refine/randoms.js";
import { Reflection } from "../src/refine/reflection.js";
import { type Lit, Scattering, strategyShares } from "../src/refine/scattering.js";
import { brightness, SkyLight } from "../src/refine/skyLight.js";
import {
  type SurfacePoints,
  type SurfaceSamples,
  surfacePoints,
  unfolded,
} from "../src/refine/surfacePoints.js";
import type { Tracer } from "../src/refine/tracer.js";
import { rotated, vector } from "../src/refine/vectors.js";

// Sums over the sphere take half a second on a machine with nothing else to do.
vi.setConfig({ testTimeout: 60_000 });

type Levels = ConstructorParameters<typeof SkyLight>[0];

const [mapHeight, mapWidth] = [24, 48];
/** A turn about an axis of no symmetry, rows. */
const turn = (() => {
  const [a, b] = [0.7, -0.4];
  const [ca, sa, cb, sb] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b)];
  return [ca * cb, -sa, ca * sb, sa * cb, ca, sa * sb, -sb, 0, cb];
})();

/** A map with a small bright spot, a coloured wall and a dim rest, twice: as two levels. */
function levels(): Levels {
  const halfRgba = new Uint16Array(4 * mapWidth * mapHeight);
  for (let row = 0; row < mapHeight; row++) {
    for (let column = 0; column < mapWidth; column++) {
      const spot = row >= 5 && row < 7 && column >= 20 && column < 22 ? 60 : 0;
      const wall = column > 36 ? 2 : 0;
      const rgb = [0.2 + spot, 0.3 + spot, 0.4 + 0.5 * spot + wall];
      rgb.forEach((value, channel) => {
        halfRgba[4 * (row * mapWidth + column) + channel] = toHalf(value);
      });
    }
  }
  const place = [0, 0, mapWidth, mapHeight] as const;
  return { width: mapWidth, height: mapHeight, halfRgba, places: [place, place] };
}

const sky = new SkyLight(levels(), turn, 1.5);
const sampler = new LightSampler(brightness(sky.levels));

function unit(...values: number[]): Float64Array {
  const length = Math.hypot(...values);
  return Float64Array.from(values, (value) => value / length);
}

/** Call with directions of the world spread over the sphere, and the solid angle of each. */
function overSphere(rows: number, use: (direction: Float64Array, solidAngle: number) => void): void {
  const direction = vector();
  for (let row = 0; row < rows; row++) {
    const solidAngle = pixelSolidAngle(row, rows, 2 * rows);
    for (let column = 0; column < 2 * rows; column++) {
      rotated(
        turn,
        Float64Array.from(directionOfUv([(column + 0.5) / (2 * rows), (row + 0.5) / rows])),
        direction,
      );
      use(direction, solidAngle);
    }
  }
}

function onePoint(albedo: readonly number[], alpha: number, metalness: number): SurfacePoints {
  return {
    count: 1,
    pixel: Uint32Array.of(0),
    position: Float32Array.of(0, 0, 0),
    normal: Float32Array.from(unit(0.2, -0.3, 1)),
    omegaO: Float32Array.from(unit(0.9, 0.3, 0.7)),
    albedo: Float32Array.from(albedo),
    alpha: Float32Array.of(alpha),
    metalness: Float32Array.of(metalness),
  };
}

const surfaces = {
  "a matt surface": onePoint([0.7, 0.5, 0.2], 1, 0),
  "a rough metal": onePoint([0.9, 0.7, 0.3], 0.25, 1),
  "a glossy plastic": onePoint([0.3, 0.1, 0.6], 0.09, 0.1),
};

/** Every ray meets the same. */
function evenTracer(opacity: number): Tracer {
  return {
    backend: "wasm",
    slow: true,
    originOffset: 0.01,
    raysPerCall: 64,
    trace: async (rays) => ({
      opacity: new Float32Array(rays.length / 6).fill(opacity),
      distance: new Float32Array(rays.length / 6).fill(2),
    }),
  };
}

describe("points of a picture", () => {
  const seen: SurfaceSamples = {
    camera: {
      ...{ width: 2, height: 2, focalX: 2, focalY: 2, centreX: 1, centreY: 1 },
      cameraToWorld: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5, 0, 0, 0, 1],
    },
    samples: 1,
    place: Uint32Array.of(0),
    normal: Uint32Array.of(0),
    distance: Float32Array.of(5),
    // Albedo (1, 1/2, 1/4) in 16 bits, roughness 0.8 and metalness 0.6 in 8.
    material: Uint32Array.of(0xffff + 0x8000 * 0x10000, 0x4000 + 204 * 0x10000 + 153 * 0x1000000),
  };
  const edit = {
    ...{ albedoGain: [1, 1, 2] as const, albedoScaleRgb: [1, 0.5, 1] },
    ...{ roughnessScale: 0.5, metalnessShift: 0.1 },
  };

  it("have the normal of their sample", () => {
    // As the shader folds (0.6, -0.48, 0.64) and (0.48, 0.6, -0.64): over and under the horizon.
    const sample = (x: number, y: number): number =>
      (Math.round(32767 * x) & 0xffff) + (Math.round(32767 * y) & 0xffff) * 0x10000;
    const sum = 0.6 + 0.48 + 0.64;
    const [above, below] = [sample(0.6 / sum, -0.48 / sum), sample(1 - 0.6 / sum, 1 - 0.48 / sum)];
    for (const [word, wanted] of [
      [above, [0.6, -0.48, 0.64]],
      [below, [0.48, 0.6, -0.64]],
    ] as const) {
      unfolded(word).forEach((value, axis) => {
        expect(value).toBeCloseTo(wanted[axis]!, 4);
      });
    }
    const points = surfacePoints({ ...seen, normal: Uint32Array.of(above) }, edit);
    [0.6, -0.48, 0.64].forEach((value, axis) => {
      expect(points.normal[axis]).toBeCloseTo(value, 4);
    });
  });

  it("have the material of their sample, edited", () => {
    const points = surfacePoints(seen, edit);
    [...points.albedo].forEach((value, axis) => {
      expect(value).toBeCloseTo([1, 0.25, 0.5][axis]!, 4);
    });
    expect(points.alpha[0]).toBeCloseTo(0.4 ** 2, 5);
    expect(points.metalness[0]).toBeCloseTo(0.7, 5);
  });
});

describe("random numbers", () => {
  it("are even, and another sequence for every point and pass", () => {
    const randoms = new Randoms();
    let [sum, squares] = [0, 0];
    const firsts = new Set<number>();
    for (let point = 0; point < 200; point++) {
      for (let pass = 0; pass < 10; pass++) {
        randoms.begin(1, pass, point);
        const value = randoms.next();
        firsts.add(value);
        sum += value;
        squares += value * value;
      }
    }
    expect(firsts.size).toBe(2000);
    expect(Math.abs(sum / 2000 - 1 / 2)).toBeLessThan(5 / Math.sqrt(12 * 2000));
    expect(Math.abs(squares / 2000 - 1 / 3)).toBeLessThan(5 * Math.sqrt(4 / 45 / 2000));
  });
});

describe("sampling the light", () => {
  const axis = unit(0.5, -0.2, 0.8);

  it("has a density that integrates to one, for every lobe", () => {
    for (const lobe of [cosineLobe, lobeOfAlpha(1), lobeOfAlpha(0.3), lobeOfAlpha(0.01)]) {
      const row = tableRow(axis, lobe);
      let sum = 0;
      for (let pixel = 0; pixel < mapWidth * mapHeight; pixel++) {
        sum +=
          sampler.density(row, pixel) * pixelSolidAngle(Math.floor(pixel / mapWidth), mapHeight, mapWidth);
      }
      expect(sum).toBeCloseTo(1, 9);
    }
  });

  it("draws as often as its density says", () => {
    const row = tableRow(axis, lobeOfAlpha(0.5));
    const counts = new Float64Array(mapWidth * mapHeight);
    const direction = vector();
    const [randoms, total] = [new Randoms(), 60_000];
    randoms.begin(3, 0, 0);
    for (let index = 0; index < total; index++) {
      sampler.sample(randoms.next(), randoms.next(), row, direction);
      counts[sampler.pixelOf(direction)]!++;
    }
    let worst = 0;
    counts.forEach((count, pixel) => {
      const solidAngle = pixelSolidAngle(Math.floor(pixel / mapWidth), mapHeight, mapWidth);
      const expected = total * sampler.density(row, pixel) * solidAngle;
      worst = Math.max(worst, Math.abs(count - expected) / Math.sqrt(expected + 9));
    });
    expect(worst).toBeLessThan(5);
  });

  it("keeps the sum of a map whose sampling pixels are larger than its own, and of a black one", () => {
    const values = Float64Array.from({ length: 1024 * 1024 }, (_, index) => (index % 7 === 0 ? 1 : 0));
    const masses = pixelMasses({ width: 1024, height: 1024, values });
    expect([masses.width, masses.height]).toEqual([1024, 512]);
    expect(masses.values.reduce((sum, value) => sum + value, 0)).toBeCloseTo(1, 9);
    const black = pixelMasses({ width: 8, height: 4, values: new Float64Array(32) });
    expect(black.values.reduce((sum, value) => sum + value, 0)).toBeCloseTo(1, 9);
    expect(Math.min(...black.values)).toBeGreaterThan(0);
  });
});

describe("scattering", () => {
  it("divides the directions by what the lobes reflect of the light", () => {
    const even = { cosine: 1, diffuseMean: 1, specularMean: 1 };
    const shares = (lit: Partial<Lit>): number[] => {
      const out = new Float64Array(4);
      strategyShares({ meanAlbedo: 0.8, metalness: 0, alpha: 0.25, ...even, ...lit }, out);
      expect(out.reduce((sum, value) => sum + value, 0)).toBeCloseTo(1, 12);
      return [...out];
    };
    const plain = shares({});
    // 0.04 of 0.84 is below the least share of the specular lobe.
    expect(plain[0]! + plain[1]!).toBeCloseTo(0.9, 12);
    expect(plain[0]).toBeCloseTo(0.72, 12);
    const lamp = shares({ specularMean: 100 });
    expect(lamp[2]! + lamp[3]!).toBeCloseTo(4 / 4.8, 12);
    expect(lamp[3]! / lamp[2]!).toBeCloseTo(3 / 7, 12);
    const grazing = shares({ cosine: 0.05, specularMean: 2 });
    expect(grazing[2]).toBeGreaterThan(shares({ cosine: 0.05, specularMean: 2, alpha: 1 })[2]!);
    expect(shares({ metalness: 1 })[0]).toBeCloseTo(0.8 * 0.05, 12);
    // Nothing is mirrored towards a viewer behind the surface.
    expect(shares({ cosine: -0.1, specularMean: 100 })[2]).toBeCloseTo(0.07, 12);
  });

  it("knows the mean of the light under a lobe", () => {
    const flat = new LightSampler({ width: 48, height: 24, values: new Float64Array(48 * 24).fill(2) });
    for (const lobe of [cosineLobe, lobeOfAlpha(1), lobeOfAlpha(0.3)]) {
      const mean = flat.mean(tableRow(unit(0.5, -0.2, 0.8), lobe));
      expect(4 * Math.PI * mean).toBeGreaterThan(0.85);
      expect(4 * Math.PI * mean).toBeLessThan(1.15);
    }
    const row = (x: number): number => tableRow(unit(x, 0.1, 0.2), lobeOfAlpha(0.3));
    expect(sampler.mean(row(1))).not.toBeCloseTo(sampler.mean(row(-1)), 3);
  });

  it.each(Object.entries(surfaces))("of %s has a density that integrates to one at most", (_, point) => {
    const scattering = new Scattering(point, sampler, turn);
    scattering.aim(0);
    let sum = 0;
    overSphere(120, (direction, solidAngle) => {
      scattering.omegaI.set(direction);
      sum += scattering.pdf() * solidAngle;
    });
    // Mirroring at half vectors may lead into the surface's back, where some of it is lost.
    expect(sum).toBeLessThan(1.01);
    expect(sum).toBeGreaterThan(0.9);
  });

  it.each(Object.entries(surfaces))("of %s gives what a sum over the sphere gives", async (_, point) => {
    const [expected, reflection, radiance] = [[0, 0, 0], new Reflection(), vector()];
    let free = 0;
    const [normal, omegaO] = [Float64Array.from(point.normal), Float64Array.from(point.omegaO)];
    const [metal, alpha] = [point.metalness[0]!, point.alpha[0]!];
    overSphere(200, (direction, solidAngle) => {
      reflection.set(omegaO, direction, normal, alpha);
      sky.radiance(direction, radiance);
      free += reflection.cosinePdf * solidAngle;
      for (let channel = 0; channel < 3; channel++) {
        const base = point.albedo[channel]!;
        const f0 = metal * base + (1 - metal) * dielectricF0;
        const lobes =
          (1 - metal) * base * reflection.cosinePdf + f0 * reflection.specular + reflection.grazing;
        expected[channel]! += lobes * radiance[channel]! * solidAngle;
      }
    });
    expect(free).toBeCloseTo(1, 3);
    const opacity = 0.25;
    const hits = {
      texelAt: () => 0,
      radiance: (...[, , out]: Parameters<Hits["radiance"]>) => out.set([1, 2, 3]),
    } as unknown as Hits;
    const scene = { points: point, light: sky, sampler, hits, originOffset: 0.01 };
    const sums = new Accumulation(point, { width: 1, height: 1 }, 1);
    let [bounced, bouncedSquares] = [0, 0];
    const numPasses = 250;
    for (let pass = 0; pass < numPasses; pass++) {
      const means = await onePass({ ...scene }, evenTracer(opacity), 8, 1, pass, () => false);
      sums.add({ ...means!, indirectRgb: new Float32Array(3) });
      bounced += means!.indirectRgb[0]!;
      bouncedSquares += means!.indirectRgb[0]! ** 2;
    }
    const picture = sums.picture(8);
    for (let channel = 0; channel < 3; channel++) {
      const z =
        (picture.directRgb[channel]! - (1 - opacity) * expected[channel]!) /
        picture.standardErrorRgb[channel]!;
      expect(Math.abs(z)).toBeLessThan(4.5);
    }
    expect(picture.relativeError).toBeLessThan(0.06);
    expect(picture.visibility[0]).toBeCloseTo(1 - opacity, 1);
    // Bounced light of radiance 1 is the directional albedo times the opacity.
    let reflectance = 0;
    overSphere(120, (direction, solidAngle) => {
      reflection.set(omegaO, direction, normal, alpha);
      const f0 = metal * point.albedo[0]! + (1 - metal) * dielectricF0;
      reflectance +=
        ((1 - metal) * point.albedo[0]! * reflection.cosinePdf +
          f0 * reflection.specular +
          reflection.grazing) *
        solidAngle;
    });
    const mean = bounced / numPasses;
    const error = Math.sqrt((bouncedSquares / numPasses - mean * mean) / (numPasses - 1));
    expect(Math.abs(mean - opacity * reflectance) / error).toBeLessThan(4.5);
  });

  it("is the same whatever number of rays is traced at once, and stops when told", async () => {
    const point = surfaces["a rough metal"];
    const points: SurfacePoints = {
      ...point,
      count: 5,
      pixel: Uint32Array.of(0, 0, 1, 1, 2),
      position: new Float32Array(15),
      normal: Float32Array.from({ length: 15 }, (_, index) => point.normal[index % 3]!),
      omegaO: Float32Array.from({ length: 15 }, (_, index) => point.omegaO[index % 3]!),
      albedo: Float32Array.from({ length: 15 }, (_, index) => point.albedo[index % 3]!),
      alpha: new Float32Array(5).fill(0.25),
      metalness: new Float32Array(5).fill(1),
    };
    const scene = { points, light: sky, sampler, hits: null, originOffset: 0 };
    const wide = await onePass(scene, { ...evenTracer(0.5), raysPerCall: 1000 }, 4, 1, 0, () => false);
    const narrow = await onePass(scene, { ...evenTracer(0.5), raysPerCall: 4 }, 4, 1, 0, () => false);
    expect(narrow).toEqual(wide);
    expect(new Set(wide!.directRgb).size).toBeGreaterThan(5);
    expect(wide!.indirectRgb.every((value) => value === 0)).toBe(true);
    let asked = 0;
    expect(
      await onePass(scene, { ...evenTracer(0.5), raysPerCall: 4 }, 4, 1, 0, () => ++asked > 2),
    ).toBeNull();
  });
});

describe("accumulating", () => {
  it("states mean, coverage and the standard error of the mean", () => {
    const point = { ...surfaces["a matt surface"], count: 2, pixel: Uint32Array.of(1, 1) };
    const sums = new Accumulation(point, { width: 2, height: 1 }, 2);
    const pass = (a: number, b: number) => ({
      directRgb: Float32Array.of(a, a, a, b, b, b),
      indirectRgb: new Float32Array(6).fill(1),
      visibility: Float32Array.of(0.5, 1),
    });
    sums.add(pass(1, 4));
    sums.add(pass(3, 4));
    const picture = sums.picture(4);
    expect([...picture.coverage]).toEqual([0, 0.5]);
    expect([...picture.directRgb]).toEqual([0, 0, 0, 3, 3, 3]);
    expect([...picture.indirectRgb]).toEqual([0, 0, 0, 1, 1, 1]);
    expect([...picture.visibility]).toEqual([0, 0.75]);
    // Values 2 and 4 of one point: their mean has the standard error 1, that of the pixel's two points half of it.
    expect([...picture.standardErrorRgb]).toEqual([0, 0, 0, 0.5, 0.5, 0.5]);
    expect(picture.samplesPerPixel).toBe(32);
    expect(picture.relativeError).toBeCloseTo(3 / 2 / (9 + 15), 6);
  });
});
