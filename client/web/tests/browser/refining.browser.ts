import { join } from "node:path";
import type { BrowserContext, Page } from "playwright-core";
import { describe, expect, inject, it } from "vitest";
import { halfValue } from "../../src/engine/half.js";
import type { RefineOptions } from "../../src/refine/status.js";
import { sharedChromium } from "../support/chromium.js";
import { serveFolders } from "../support/server.js";
import { fixedView, keep, meanDifference } from "./support.js";

const size = { width: 300, height: 220 };
const browser = await sharedChromium();

/** Open an element without controls, of a size that its page gives it. */
async function openElement(context: BrowserContext, site = inject("site")): Promise<Page> {
  const page = await context.newPage();
  const state = `env=preset:sunset&background=transparent&${new URLSearchParams(fixedView)}`;
  await page.goto(`${site}/pages/twelve.html?${new URLSearchParams({ count: "1", state })}`);
  await page.waitForFunction(() => document.querySelector("lambent-viewer") !== null);
  await page.addStyleTag({
    content: `main { display: block } lambent-viewer { display: block; width: ${size.width}px; height: ${size.height}px }`,
  });
  await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
  return page;
}

describe("several workers", () => {
  it.each([
    ["that have copies", false],
    ["that share memory", true],
  ] as const)("%s read the bundle once", async (_, isolated) => {
    const folders = {
      ...{ "": inject("pages"), data: inject("fixture") },
      pages: join(import.meta.dirname, "pages"),
    };
    const server = await serveFolders(folders, { isolated });
    const context = await browser.newContext({ viewport: size, bypassCSP: true, reducedMotion: "reduce" });
    const read: string[] = [];
    context.on("request", (request) => read.push(new URL(request.url()).pathname.split("/").at(-1)!));
    const page = await openElement(context, server.url);
    const found = await page.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      const viewer = element.viewer!;
      viewer.refineOptions = { ...viewer.refineOptions, workers: 3, samplesPerPixel: 96, relativeError: 0 };
      const done = new Promise<string>((resolve) => {
        viewer.on("refine", ({ phase, message }) => {
          if (phase === "done" || phase === "failed") resolve(`${phase} ${message}`);
        });
      });
      await element.update({ refine: true });
      return [crossOriginIsolated, await done, viewer.refined!.samplesPerPixel];
    });
    expect(found.slice(0, 2)).toEqual([isolated, "done "]);
    expect(found[2]).toBeGreaterThanOrEqual(96);
    expect(read.filter((name) => name === "shadow_bits.bin")).toHaveLength(1);
    // Once to show the object, once to refine it.
    expect(read.filter((name) => name === "manifest.json")).toHaveLength(2);
    await context.close();
    await server.close();
  });
});

describe("a mesh with its own materials", () => {
  it("is refined with those of its texels, which were not read to show it", async () => {
    const context = await browser.newContext({ viewport: size, bypassCSP: true, reducedMotion: "reduce" });
    const page = await openElement(context);
    const [phase, values] = await page.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      await element.show("/data/golden/ball.relight.zip");
      const viewer = element.viewer!;
      viewer.refineOptions = { ...viewer.refineOptions, workers: 2, samplesPerPixel: 32, relativeError: 0 };
      const done = new Promise<string>((resolve) => {
        viewer.on("refine", (status) => {
          if (status.phase === "done" || status.phase === "failed")
            resolve(`${status.phase} ${status.message}`);
        });
      });
      await element.update({ refine: true });
      const ended = await done;
      const { directRgb, indirectRgb } = viewer.refined!;
      return [
        ended,
        [directRgb, indirectRgb].map((rgb) => rgb.reduce((sum, value) => sum + value, 0)),
      ] as const;
    });
    expect(phase).toBe("done ");
    expect(values[0]).toBeGreaterThan(0);
    expect(Number.isFinite(values[1])).toBe(true);
    await context.close();
  });
});

describe("refining", () => {
  it.each([
    ["comes in little by little", "no-preference"],
    ["is there at once where less motion is wanted", "reduce"],
  ] as const)("%s", { timeout: 300_000 }, async (_, reducedMotion) => {
    const context = await browser.newContext({ viewport: size, bypassCSP: true, reducedMotion });
    const page = await openElement(context);
    const frames = await page.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      const viewer = element.viewer!;
      viewer.dither = false;
      viewer.refineOptions = { ...viewer.refineOptions, workers: 1, samplesPerPixel: 64, relativeError: 0 };
      const pictures: number[][] = [];
      const grab = (): void => {
        const { width, height } = viewer.canvas;
        const context = new OffscreenCanvas(width, height).getContext("2d")!;
        context.drawImage(viewer.canvas, 0, 0);
        pictures.push([...context.getImageData(0, 0, width, height).data]);
      };
      viewer.drawNow(2);
      grab();
      const done = new Promise<void>((resolve) => {
        viewer.on("refine", ({ phase }) => {
          if (phase === "done") setTimeout(resolve, 3000);
        });
      });
      viewer.on("draw", () => {
        if (viewer.refined !== null) grab();
      });
      await element.update({ refine: true });
      await done;
      return pictures;
    });
    const bytes = frames.map((frame) => Uint8Array.from(frame));
    const [baked, first, last] = [bytes[0]!, bytes[1]!, bytes.at(-1)!];
    keep(`refining_baked_${reducedMotion}`, baked, size.width);
    keep(`refining_last_${reducedMotion}`, last, size.width);
    const whole = meanDifference(baked, last);
    const steps = bytes.slice(1).map((frame, index) => meanDifference(frame, bytes[index]!));
    console.log({ frames: bytes.length, whole, steps });
    expect(whole).toBeGreaterThan(0.3);
    if (reducedMotion === "reduce") {
      expect(steps[0]).toBeGreaterThan(0.5 * whole);
      // One for each picture that came.
      expect(bytes.length).toBeLessThan(5);
    } else {
      // Nothing pops as it begins, and no frame changes more than a part of all.
      expect(meanDifference(baked, first)).toBe(0);
      expect(bytes.length).toBeGreaterThan(5);
      expect(Math.max(...steps)).toBeLessThan(0.5 * whole);
    }
    await context.close();
  });

  it("with fewer points than pixels is as sharp as the baked picture", { timeout: 300_000 }, async () => {
    const context = await browser.newContext({ viewport: size, bypassCSP: true, reducedMotion: "reduce" });
    const page = await openElement(context);
    const refined = (options: Partial<RefineOptions>) =>
      page.evaluate(async (given) => {
        const element = document.querySelector("lambent-viewer")!;
        const viewer = element.viewer!;
        await element.update({ refine: false });
        const plain = { workers: 1, denoise: false, relativeError: 0, samplesPerPixel: 256 };
        viewer.refineOptions = { ...viewer.refineOptions, ...plain, ...given };
        let stop = (): void => {};
        const done = new Promise<void>((resolve) => {
          stop = viewer.on("refine", ({ phase }) => {
            if (phase === "done") resolve();
          });
        });
        await element.update({ refine: true });
        await done;
        stop();
        const { width, height, directRgb, indirectRgb, coverage } = viewer.refined!;
        return {
          ...{ width, height, coverage: [...coverage] },
          radiance: directRgb.map((value, index) => value + indirectRgb[index]!).join(" "),
          shown: viewer.radiance(viewer.canvas.width, viewer.canvas.height).join(" "),
        };
      }, options);
    const numbers = (list: string): number[] => list.split(" ").map(Number);
    const fine = await refined({});
    const coarse = await refined({ points: 2500 });
    expect([fine.width, fine.height]).toEqual([size.width, size.height]);
    const step = Math.round(size.width / coarse.width);
    expect(step).toBeGreaterThanOrEqual(3);
    const wanted = halves(numbers(fine.shown));
    const guided = halves(numbers(coarse.shown));
    const radiance = numbers(coarse.radiance);
    const nearest = new Float32Array(wanted.length);
    for (let pixel = 0; pixel < size.width * size.height; pixel++) {
      const column = Math.floor((((pixel % size.width) + 0.5) / size.width) * coarse.width);
      const row = Math.floor(((Math.floor(pixel / size.width) + 0.5) / size.height) * coarse.height);
      const other = row * coarse.width + column;
      const share = coarse.coverage[other]!;
      nearest.set(
        [...radiance.slice(3 * other, 3 * other + 3).map((value) => share * value), share],
        4 * pixel,
      );
    }
    for (const [name, picture] of Object.entries({ wanted, guided, nearest })) {
      keep(
        `refining_${name}`,
        Uint8Array.from(picture, (value) => 255 * Math.min(value, 1) ** 0.45),
        size.width,
      );
    }
    const ratios = { guided: psnr(guided, wanted), nearest: psnr(nearest, wanted) };
    console.log({ step, ...ratios });
    expect(ratios.guided).toBeGreaterThan(ratios.nearest + 3);
    // The outline is the baked picture's.
    for (let at = 3; at < wanted.length; at += 4) expect(guided[at]).toBe(wanted[at]);
    await context.close();
  });
});

/** Return the numbers of halves. */
function halves(bits: readonly number[]): Float32Array {
  return Float32Array.from(bits, halfValue);
}

/** Return the peak signal-to-noise ratio of radiance as it is displayed, in dB. */
function psnr(found: Float32Array, wanted: Float32Array): number {
  const shown = (value: number): number => Math.min(Math.max(value, 0), 1) ** (1 / 2.2);
  let sum = 0;
  for (let index = 0; index < wanted.length; index++)
    sum += (shown(found[index]!) - shown(wanted[index]!)) ** 2;
  return -10 * Math.log10(sum / wanted.length);
}
