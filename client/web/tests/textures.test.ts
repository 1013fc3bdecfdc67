import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { MaterialMaps } from "../src/bundle/load.js";
import { tableWidth, type PackedTransport, type PlaneTable } from "../src/bundle/transport.js";
import { BundleTextures, fitted, longestSide } from "../src/render/textures.js";

const table = (rows: number): PlaneTable => ({
  bands: 1,
  layers: 1,
  rows,
  steps: new Int8Array(4 * rows * tableWidth),
  scales: new Float32Array(4),
  offsets: new Float32Array(4),
});

const transport = (size: number, rows: number): PackedTransport => ({
  size,
  numTexels: 1,
  texelPlane: new Uint32Array(size * size),
  blocksAround: new Uint32Array(4 * tableWidth),
  direct: table(rows),
  visibility: table(1),
  indirect: table(1),
  coarseOfTexel: new Uint32Array(tableWidth),
});

const closed: number[] = [];
const picture = (width: number, height: number): ImageBitmap => ({
  ...{ width, height },
  close: () => closed.push(width),
});

/** Stands for the browser's; it records what is drawn at which size. */
const drawn: [from: number, to: number][] = [];
class FakeCanvas {
  constructor(
    readonly width: number,
    readonly height: number,
  ) {}
  getContext() {
    return {
      drawImage: (from: ImageBitmap, _x: number, _y: number, width: number, height: number) => {
        expect([width, height]).toEqual([this.width, this.height]);
        drawn.push([from.width, width]);
      },
    };
  }
  transferToImageBitmap(): ImageBitmap {
    return picture(this.width, this.height);
  }
}

beforeEach(() => vi.stubGlobal("OffscreenCanvas", FakeCanvas));
afterEach(() => {
  vi.unstubAllGlobals();
  drawn.length = 0;
  closed.length = 0;
});

describe("a picture beyond what the graphics card takes", () => {
  it("is halved until it fits, each pixel a mean of four", () => {
    const found = fitted(picture(8192, 8192), 2048);
    expect([found.width, found.height]).toEqual([2048, 2048]);
    expect(drawn).toEqual([
      [8192, 4096],
      [4096, 2048],
    ]);
    // Those in between, and what was given, are of no more use.
    expect(closed).toEqual([8192, 4096]);
  });

  it("is itself where it fits", () => {
    const given = picture(4096, 4096);
    expect(fitted(given, 4096)).toBe(given);
    expect(closed).toEqual([]);
  });

  it("is made smaller for the albedo alone where the others fit", () => {
    const maps = {
      albedo: picture(4096, 4096),
      packed: picture(512, 512),
      normal: picture(512, 512),
    } as MaterialMaps;
    const whole = new BundleTextures(transport(16, 1), null, maps, 4096);
    expect((whole.albedoMap.image as ImageBitmap).width).toBe(4096);
    const reduced = new BundleTextures(transport(16, 1), null, maps, 2048);
    expect((reduced.albedoMap.image as ImageBitmap).width).toBe(2048);
    expect((reduced.normalMap.image as ImageBitmap).width).toBe(512);
    closed.length = 0;
    reduced.dispose();
    expect(closed.sort()).toEqual([2048, 512, 512]);
  });
});

describe("the tables of a transport", () => {
  it("need the width of a table, the atlas, or the rows of the longest table", () => {
    expect(longestSide(transport(16, 3))).toBe(tableWidth);
    expect(longestSide(transport(2048, 3))).toBe(2048);
    expect(longestSide(transport(16, 5000))).toBe(5000);
  });
});
