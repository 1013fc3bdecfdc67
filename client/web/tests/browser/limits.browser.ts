import type { CDPSession, Page } from "playwright-core";
import { beforeAll, describe, expect, inject, it } from "vitest";
import { scriptBytes } from "../../scripts/script_bytes.mjs";
import { sharedChromium } from "../support/chromium.js";
import { fixedView, openViewer } from "./support.js";

const browser = await sharedChromium();
let page: Page;
let session: CDPSession;
const loaded = new Set<string>();

beforeAll(async () => {
  const context = await browser.newContext({ viewport: { width: 160, height: 120 } });
  context.on("request", (request) => {
    const name = new URL(request.url()).pathname.split("/").at(-1)!;
    if (name.endsWith(".js")) loaded.add(name);
  });
  await context.addInitScript(countThings, kinds);
  page = await openViewer(context, { ...fixedView, env: "preset:studio" });
  session = await context.newCDPSession(page);
});

describe("the scripts that a page loads before it refines", () => {
  it("are those that are counted, and weigh 300 KB at most", () => {
    const counted = scriptBytes(inject("pages"));
    expect([...loaded].sort()).toEqual(Object.keys(counted).sort());
    const total = Object.values(counted).reduce((sum, size) => sum + size, 0);
    console.log(`${(total / 1000).toFixed(1)} KB of JavaScript, gzip -9`);
    expect(total).toBeGreaterThan(100_000);
    expect(total).toBeLessThanOrEqual(300_000);
  });
});

/** Kinds of things on the graphics card; the page counts how many of each were made and not yet deleted. */
const kinds = ["Buffer", "Framebuffer", "Program", "Renderbuffer", "Shader", "Texture", "VertexArray"];

function countThings(names: readonly string[]): void {
  const things: Record<string, number> = {};
  Object.assign(globalThis, { things });
  for (const name of names) {
    things[name] = 0;
    for (const [verb, step] of [
      ["create", 1],
      ["delete", -1],
    ] as const) {
      const prototype = WebGL2RenderingContext.prototype as unknown as Record<string, () => unknown>;
      const before = prototype[verb + name]!;
      prototype[verb + name] = function (...given: []) {
        if (verb === "create" || (given as unknown[])[0]) things[name]! += step;
        return before.apply(this, given);
      };
    }
  }
}

/** Return what lies on the graphics card, as three counts it and as the page made and deleted it. */
const card = (): Promise<Record<string, number>> =>
  page.evaluate(() => ({
    ...document.querySelector("lambent-viewer")!.viewer!.memory,
    ...(globalThis as unknown as { things: Record<string, number> }).things,
  }));

/** The memory of a page: how many values, and bytes of arrays. */
type Held = { readonly values: number; readonly arrayBytes: number };

/** Return the least of what the page holds at three times: what is on its way to a worker passes, a leak stays. */
async function held(): Promise<Held> {
  const found: Held[] = [];
  for (let index = 0; index < 3; index++) {
    if (index > 0) await new Promise((resolve) => setTimeout(resolve, 300));
    found.push(await heldNow());
  }
  return {
    values: Math.min(...found.map(({ values }) => values)),
    arrayBytes: Math.min(...found.map(({ arrayBytes }) => arrayBytes)),
  };
}

/**
 * Return what the page holds after a forced collection. The heap's size itself would tell little: the browser compiles
 * code and keeps timings as it goes.
 */
async function heldNow(): Promise<Held> {
  await session.send("HeapProfiler.collectGarbage");
  const { result } = await session.send("Runtime.evaluate", { expression: "Object.prototype" });
  const { objects } = await session.send("Runtime.queryObjects", { prototypeObjectId: result.objectId! });
  const counted = await session.send("Runtime.callFunctionOn", {
    objectId: objects.objectId!,
    functionDeclaration: "function () { return this.length; }",
    returnByValue: true,
  });
  for (const { objectId } of [objects, result]) {
    await session.send("Runtime.releaseObject", { objectId: objectId! });
  }
  // The types do not know this number yet.
  const usage = (await session.send("Runtime.getHeapUsage")) as { backingStorageSize?: number };
  return { values: counted.result.value as number, arrayBytes: usage.backingStorageSize! };
}

describe("memory", () => {
  /** A map of 2 x 1 pixels; presets are larger, and take longer. */
  const map = (red: number): string =>
    btoa(
      `#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n${String.fromCharCode(red, 90, 90, 129, 128, 90, red, 130)}`,
    );

  /** Change the light, turned, and draw; now and then with its shadow on the ground, and compared with another. */
  const light = (times: number) =>
    page.evaluate(
      async (maps) => {
        const element = document.querySelector("lambent-viewer")!;
        const viewer = element.viewer!;
        for (const [index, text] of maps.entries()) {
          const { look, turn } = viewer.state;
          const data = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
          await element.setEnvironmentFile(new File([data], `map${index % 2}.hdr`));
          await viewer.update({
            compare: index % 10 === 4 ? "environment" : "off",
            look: { ...look, ground: index % 10 === 0 },
            turn: { ...turn, yawDeg: 7 * index },
          });
          viewer.drawNow(1);
        }
      },
      Array.from({ length: times }, (_, index) => map(100 + index)),
    );
  const open = (times: number) =>
    page.evaluate(async (count) => {
      const element = document.querySelector("lambent-viewer")!;
      for (let index = 0; index < count; index++) {
        await element.show(index % 2 === 0 ? "data/bundle/" : "data/bundle.relight.zip");
        element.viewer!.drawNow(1);
      }
    }, times);

  it("does not grow over 50 lights and 20 bundles", { timeout: 400_000 }, async () => {
    // Everything was there once: both bundles, both maps, the comparison, the ground.
    await light(6);
    await open(2);
    await light(6);
    const before = { ...(await held()), card: await card() };
    await light(22);
    await light(22);
    await open(20);
    // As much to undo as before.
    await light(6);
    const after = { ...(await held()), card: await card() };
    console.log("memory before and after", JSON.stringify([before, after]));
    expect(before.card.Texture).toBeGreaterThan(10);
    expect(before.arrayBytes).toBeGreaterThan(1_000_000);
    expect(after.card).toEqual(before.card);
    expect(after.arrayBytes - before.arrayBytes).toBeLessThan(10_000);
    // Less than one for every light and bundle.
    expect(after.values - before.values).toBeLessThan(70);
  });
});
