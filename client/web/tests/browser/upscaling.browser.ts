import { join } from "node:path";
import type { Page } from "playwright-core";
import { build, type Rollup } from "vite";
import { beforeAll, describe, expect, inject, it } from "vitest";
import { refinedShares } from "../../src/refine/blending.js";
import { Randoms } from "../../src/refine/randoms.js";
import { leastReflectance, leastWeight, upscaling } from "../../src/refine/refinedLayer.js";
import { unfolded } from "../../src/refine/surfacePoints.js";
import { sharedChromium } from "../support/chromium.js";
import type { LayerCase } from "./layerPage.js";

const browser = await sharedChromium();
let page: Page;

beforeAll(async () => {
  const built = (await build({
    ...{ configFile: false, logLevel: "error" },
    build: {
      write: false,
      lib: { entry: join(import.meta.dirname, "layerPage.ts"), formats: ["es"], fileName: "layer" },
      // One script, with all languages.
      rolldownOptions: { output: { codeSplitting: false } },
    },
  })) as Rollup.RollupOutput[];
  const context = await browser.newContext({ bypassCSP: true });
  page = await context.newPage();
  await page.goto(`${inject("site")}/pages/embed.html`);
  await page.addScriptTag({ content: built[0]!.output[0].code, type: "module" });
  await page.waitForFunction(() => globalThis.drawLayer !== undefined);
});

const [width, height, samples] = [20, 14, 2];
const gain = [1.2, 0.8, 1] as const;
const camera = {
  ...{ width, height, focalX: 20, focalY: 20, centreX: 10, centreY: 7 },
  cameraToWorld: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5, 0, 0, 0, 1],
};

/** The surface at a place of the picture, shares of its size from the top left: a disc before a tilted wall. */
function surfaceAt(x: number, y: number) {
  if (y > 0.9) return null;
  if (Math.hypot(x - 0.4, y - 0.5) < 0.28) {
    return { albedo: [0.7, 0.3, x], normal: [0.6 * x, 0, 1], distance: 3 + 0.1 * x };
  }
  return {
    albedo: [0.2, 0.2 + 0.5 * Math.round(6 * x - 0.5) * 0.1, 0.5],
    normal: [-0.5, 0.2, 1],
    distance: 4 + x,
  };
}

/** A case with a refined picture of `across` x `down` pixels. */
function caseOf(across: number, down: number, channel: LayerCase["channel"], done: boolean): LayerCase {
  const randoms = new Randoms();
  randoms.begin(3, 0, 0);
  const count = across * down;
  const some = (length: number, scale: number) =>
    Float32Array.from({ length }, () => scale * (0.2 + randoms.next()));
  const features = {
    albedo: new Float32Array(3 * count),
    normal: new Float32Array(3 * count),
    distance: new Float32Array(count),
  };
  const coverage = new Float32Array(count);
  for (let pixel = 0; pixel < count; pixel++) {
    const found = surfaceAt(((pixel % across) + 0.5) / across, (Math.floor(pixel / across) + 0.5) / down);
    if (found === null) continue;
    coverage[pixel] = 1;
    features.albedo.set(
      found.albedo.map((value, axis) => value * gain[axis]!),
      3 * pixel,
    );
    const length = Math.hypot(...found.normal);
    features.normal.set(
      found.normal.map((value) => value / length),
      3 * pixel,
    );
    features.distance[pixel] = found.distance;
  }
  const [wide, high] = [width * samples, height * samples];
  const seen = new Uint32Array(4 * wide * high);
  const facing = new Uint32Array(wide * high);
  const distances = new Float32Array(seen.buffer);
  for (let row = 0; row < high; row++) {
    for (let column = 0; column < wide; column++) {
      const found = surfaceAt((column + 0.5) / wide, (row + 0.5) / high);
      if (found === null) continue;
      const at = (high - 1 - row) * wide + column;
      const steps = found.albedo.map((value) => Math.round(65535 * value));
      distances[4 * at + 1] = found.distance;
      seen[4 * at + 2] = steps[0]! + steps[1]! * 65536;
      seen[4 * at + 3] = steps[2]!;
      const sum = found.normal.reduce((total, value) => total + Math.abs(value), 0);
      const half = (value: number): number => Math.round((32767 * value) / sum) & 0xffff;
      facing[at] = half(found.normal[0]!) + half(found.normal[1]!) * 65536;
    }
  }
  const baked = some(4 * width * height, 0.5);
  for (let pixel = 0; pixel < width * height; pixel++) {
    const [row, column] = [height - 1 - Math.floor(pixel / width), pixel % width];
    baked[4 * pixel + 3] =
      surfaceAt((column + 0.5) / width, (row + 0.5) / height) === null ? 0 : 0.5 + 0.5 * (column / width);
  }
  return {
    ...{ camera, samples, channel, albedoGain: gain, done, baked, seen, facing, features },
    picture: {
      ...{ width: across, height: down, coverage, samplesPerPixel: 16, relativeError: 0.1 },
      ...{ directRgb: some(3 * count, 1), indirectRgb: some(3 * count, 0.3) },
      ...{ standardErrorRgb: some(3 * count, 0.1), visibility: some(count, 0.5) },
    },
  };
}

/** What must be drawn, pixel by pixel, in the words of the documentation. */
function expected(given: LayerCase): Float32Array {
  const { picture, features, channel, done, baked, seen, facing } = given;
  const [across, down] = [picture.width, picture.height];
  const shares = refinedShares(picture, false);
  const distances = new Float32Array(seen.buffer);
  const shown = (pixel: number): number[] =>
    [0, 1, 2].map((axis) => {
      const [direct, indirect] = [
        picture.directRgb[3 * pixel + axis]!,
        picture.indirectRgb[3 * pixel + axis]!,
      ];
      if (channel === "visibility") return picture.visibility[pixel]!;
      return channel === "direct" ? direct : channel === "indirect" ? indirect : direct + indirect;
    });
  const out = baked.slice();
  for (let pixel = 0; pixel < width * height; pixel++) {
    const [up, column] = [Math.floor(pixel / width), pixel % width];
    const covered = baked[4 * pixel + 3]!;
    if (covered === 0) continue;
    // The surface here: a mean over the samples that show it.
    const mean = { albedo: [0, 0, 0], normal: [0, 0, 0], distance: 0 };
    let count = 0;
    for (let index = 0; index < samples ** 2; index++) {
      const at =
        (samples * up + Math.floor(index / samples)) * width * samples + samples * column + (index % samples);
      if (distances[4 * at + 1] === 0) continue;
      count++;
      const [low, high] = [seen[4 * at + 2]!, seen[4 * at + 3]!];
      [low & 0xffff, low >>> 16, high & 0xffff].forEach((step, axis) => {
        mean.albedo[axis]! += step / 65535;
      });
      unfolded(facing[at]!).forEach((value, axis) => {
        mean.normal[axis]! += value;
      });
      mean.distance += distances[4 * at + 1]!;
    }
    if (count === 0) continue;
    const albedo = mean.albedo.map((value, axis) => Math.min((value / count) * gain[axis]!, 1));
    const [x, y] = [((column + 0.5) / width) * across, ((height - up - 0.5) / height) * down];
    let [total, share] = [0, 0];
    const sum = [0, 0, 0];
    for (let other = 0; other < across * down; other++) {
      const [i, j] = [Math.floor(other / across), other % across];
      const isNear =
        Math.abs(i - Math.floor(y)) <= upscaling.reach && Math.abs(j - Math.floor(x)) <= upscaling.reach;
      if (!isNear || shares[other] === 0) continue;
      const apart = (of: ArrayLike<number>, from: readonly number[]): number =>
        Math.hypot(...from.map((value, axis) => of[3 * other + axis]! - value));
      const weight =
        Math.exp(-0.5 * (Math.hypot(j + 0.5 - x, i + 0.5 - y) / upscaling.spread) ** 2) *
        Math.exp(-((apart(features.albedo, albedo) / upscaling.albedo) ** 2)) *
        Math.exp(
          -(
            (apart(
              features.normal,
              mean.normal.map((value) => value / count),
            ) /
              upscaling.normal) **
            2
          ),
        ) *
        Math.exp(
          -((Math.log(features.distance[other]! / (mean.distance / count)) / upscaling.distance) ** 2),
        );
      total += weight;
      share += weight * shares[other]!;
      shown(other).forEach((value, axis) => {
        const here =
          (albedo[axis]! + leastReflectance) / (features.albedo[3 * other + axis]! + leastReflectance);
        sum[axis]! += weight * value * (channel === "visibility" ? 1 : here);
      });
    }
    const own = Math.floor(y) * across + Math.floor(x);
    const isOwn = across === width && down === height && shares[own]! > 0;
    if (!isOwn && total < leastWeight) continue;
    const part = done ? 1 : isOwn ? shares[own]! : share / total;
    for (let axis = 0; axis < 3; axis++) {
      const value = isOwn ? shown(own)[axis]! : sum[axis]! / total;
      out[4 * pixel + axis] = (1 - part) * baked[4 * pixel + axis]! + part * covered * value;
    }
  }
  return out;
}

async function drawn(given: LayerCase): Promise<number[]> {
  // Arrays of numbers pass into the page as they are only as text.
  const text = JSON.stringify(given, (_, value: unknown) =>
    ArrayBuffer.isView(value)
      ? { kind: value.constructor.name, values: [...(value as Float32Array)] }
      : value,
  );
  return page.evaluate((json) => {
    const kinds = { Float32Array, Uint32Array };
    const given = JSON.parse(json, (_, value) =>
      value?.kind in kinds ? kinds[value.kind as keyof typeof kinds].from(value.values) : value,
    );
    return [...globalThis.drawLayer(given)];
  }, text);
}

describe("a refined picture over the baked one", () => {
  it.each([
    ["a coarser one", 7, 5, "final", false],
    ["a coarser one that is done", 10, 7, "direct", true],
    ["a coarser one of what is visible", 7, 5, "visibility", false],
    ["one at full size", width, height, "indirect", false],
  ] as const)("is what a plain loop over its pixels gives: %s", async (_, across, down, channel, done) => {
    const given = caseOf(across, down, channel, done);
    const wanted = expected(given);
    const found = await drawn(given);
    let changed = 0;
    wanted.forEach((value, index) => {
      expect(found[index]).toBeCloseTo(value, 3);
      if (Math.abs(value - given.baked[index]!) > 0.01) changed++;
    });
    expect(changed).toBeGreaterThan(width * height);
    // What covers a pixel is the baked picture's to say.
    for (let at = 3; at < found.length; at += 4) expect(found[at]).toBe(given.baked[at]);
  });
});
