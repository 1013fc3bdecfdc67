/** A page with a viewer, for tests. */

import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import type { Browser, BrowserContext, Page } from "playwright-core";
import { expect, inject } from "vitest";
import type { LambentViewerElement } from "../../src/viewer/element.js";
import type { ViewCamera } from "../../src/render/looks.js";

export type Expected = {
  readonly file: string;
  readonly map: string;
  readonly rotateDeg: number;
  readonly camera: ViewCamera;
  readonly albedoGain: readonly [number, number, number];
  readonly roughnessScale: number;
};

declare global {
  interface HTMLElementTagNameMap {
    "lambent-viewer": LambentViewerElement;
  }
}

/** Pictures that Python drew. */
export function expectedPictures(): Expected[] {
  return JSON.parse(readFileSync(join(inject("fixture"), "expected.json"), "utf8")) as Expected[];
}

/** The bytes of a file of the fixture. */
export function fixtureFile(name: string): Buffer {
  return readFileSync(join(inject("fixture"), name));
}

/** What nobody has chosen, but for the light, which then does not turn by itself. */
const atRest = { rotate: "0,0,0" };

/** A view that the viewer neither frames nor exposes, without a shadow on the ground. */
export const fixedView = { auto: "0", ground: "0", rotate: "0,0,0", camera: "30,20,3.2,0,0,0" };

/** Open the viewer's page; `parameters` follow the hash, with src unless it is null. */
export async function openViewer(
  browser: Browser | BrowserContext,
  parameters: Record<string, string> = atRest,
  src: string | null = "data/bundle/",
  size = { width: 640, height: 480 },
  site = inject("site"),
): Promise<Page> {
  const page = await ("newContext" in browser ? browser.newPage({ viewport: size }) : browser.newPage());
  page.on("pageerror", (error) => {
    throw error;
  });
  const hash = new URLSearchParams(parameters);
  if (src !== null) hash.set("src", new URL(src, `${site}/`).href);
  await page.goto(`${site}/viewer.html#${hash}`);
  await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer != null);
  if (src !== null) await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
  return page;
}

/** Return the state of a page's viewer. */
export const stateOf = (page: Page) => page.evaluate(() => document.querySelector("lambent-viewer")!.state);

/** Change the state of a page's viewer. */
export const change = (page: Page, part: object) =>
  page.evaluate((given) => document.querySelector("lambent-viewer")!.update(given), part);

/** Expect something of what is found again and again, until it is so. */
export const soon = <T>(find: () => Promise<T>) => expect.poll(find, { timeout: 20_000 });

/** Return how many pictures are drawn in some time. */
export const drawnIn = (page: Page, ms: number) =>
  page.evaluate(async (time) => {
    let count = 0;
    const stop = document.querySelector("lambent-viewer")!.viewer!.on("draw", () => count++);
    await new Promise((resolve) => setTimeout(resolve, time));
    stop();
    return count;
  }, ms);

/** Return straight RGBA bytes of what the viewer shows, or of what a camera sees; without noise unless `dither`. */
export async function pictureOf(
  page: Page,
  size: { width: number; height: number } | ViewCamera,
  samples = 2,
  dither = false,
): Promise<Uint8Array> {
  const text = await page.evaluate(
    ([asked, count, noisy]) => {
      document.querySelector("lambent-viewer")!.viewer!.dither = noisy;
      const { data } = document.querySelector("lambent-viewer")!.picture(asked, count);
      let binary = "";
      for (let start = 0; start < data.length; start += 32768) {
        binary += String.fromCharCode(...data.subarray(start, start + 32768));
      }
      return btoa(binary);
    },
    [size, samples, dither] as const,
  );
  return Uint8Array.from(Buffer.from(text, "base64"));
}

/** Collect what dialogs of the viewer announce from now on; returns what reads it. */
export async function announcements(page: Page): Promise<() => Promise<string[]>> {
  await page.evaluate(() => {
    const texts: string[] = [];
    Object.assign(globalThis, { announced: texts });
    new MutationObserver((records) => {
      for (const { target, addedNodes } of records) {
        if (!(target instanceof Element) || target.closest("dialog [role=status]") === null) continue;
        texts.push(...[...addedNodes].map((node) => node.textContent ?? ""));
      }
    }).observe(document.querySelector("lambent-viewer")!.shadowRoot!, { subtree: true, childList: true });
  });
  return () => page.evaluate(() => (globalThis as unknown as { announced: string[] }).announced);
}

/** Return the mean absolute difference of two pictures over white, in steps of 1/255. */
export function meanDifference(a: Uint8Array, b: Uint8Array): number {
  if (a.length !== b.length) throw new Error(`${a.length} and ${b.length} bytes`);
  let sum = 0;
  for (let pixel = 0; pixel < a.length; pixel += 4) {
    for (let channel = 0; channel < 3; channel++) {
      const over = (bytes: Uint8Array): number => {
        const alpha = bytes[pixel + 3]! / 255;
        return bytes[pixel + channel]! * alpha + 255 * (1 - alpha);
      };
      sum += Math.abs(over(a) - over(b));
    }
  }
  return sum / (0.75 * a.length);
}

/** Keep a picture for people who ask why a test failed. */
export function keep(name: string, rgba: Uint8Array, width: number): void {
  const folder = resolve(import.meta.dirname, "../../build/browser-tests");
  mkdirSync(folder, { recursive: true });
  const header = `P6 ${width} ${rgba.length / 4 / width} 255\n`;
  const rgb = Buffer.alloc((rgba.length / 4) * 3);
  for (let pixel = 0; pixel < rgba.length / 4; pixel++) {
    const alpha = rgba[4 * pixel + 3]! / 255;
    for (let c = 0; c < 3; c++) rgb[3 * pixel + c] = rgba[4 * pixel + c]! * alpha + 255 * (1 - alpha);
  }
  writeFileSync(join(folder, `${name}.ppm`), Buffer.concat([Buffer.from(header), rgb]));
}
