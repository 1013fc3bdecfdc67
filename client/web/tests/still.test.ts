import { describe, expect, it } from "vitest";
import { resized } from "../src/refine/plan.js";
import { stillParts, widened } from "../src/refine/still.js";
import type { ViewCamera } from "../src/render/looks.js";
import { cameraOfPart, mostSamples, tilesOf } from "../src/render/tiles.js";

const camera: ViewCamera = {
  ...{ width: 500, height: 300, focalX: 400, focalY: 420, centreX: 251, centreY: 149 },
  cameraToWorld: Array.from({ length: 16 }, (_, index) => index),
};

/** Return where a point at z = -1 of a camera's space falls, in the whole picture. */
function place(of: ViewCamera, x: number, y: number, left = 0, top = 0): [number, number] {
  return [of.centreX + of.focalX * x + left, of.centreY + of.focalY * y + top];
}

describe("the parts of a refined picture", () => {
  it.each([
    [500, 300],
    [1, 1],
    [224, 224],
    [225, 1000],
  ])("cover %i x %i pixels once", (width, height) => {
    const counts = new Uint8Array(width * height);
    for (const part of stillParts(width, height)) {
      for (let y = part.top; y < part.top + part.height; y++) {
        for (let x = part.left; x < part.left + part.width; x++) counts[y * width + x]! += 1;
      }
    }
    expect(counts.every((count) => count === 1)).toBe(true);
  });

  it("have room for the denoiser around them, inside of the picture, and not more than fits", () => {
    for (const part of stillParts(camera.width, camera.height)) {
      const wide = widened(part, camera);
      expect(wide.left).toBe(Math.max(part.left - 16, 0));
      expect(wide.left + wide.width).toBe(Math.min(part.left + part.width + 16, camera.width));
      expect(wide.top + wide.height).toBe(Math.min(part.top + part.height + 16, camera.height));
      expect(Math.max(wide.width, wide.height)).toBeLessThanOrEqual(256);
    }
  });

  it("are seen by the same camera", () => {
    const part = { left: 208, top: 16, width: 200, height: 100 };
    const found = place(cameraOfPart(camera, part), 0.3, -0.2, part.left, part.top);
    expect(found).toEqual(place(camera, 0.3, -0.2));
    const [x, y] = place(resized(camera, 250, 600), 0.3, -0.2);
    expect([2 * x, y / 2]).toEqual(place(camera, 0.3, -0.2).map((value) => expect.closeTo(value, 9)));
  });
});

describe("the tiles of a picture", () => {
  it.each([
    [640, 480, 2, 8192, 1],
    [1920, 1080, 2, 8192, 1],
    [7680, 4320, 2, 16384, null],
    [7680, 4320, 2, 4096, null],
    [8192, 64, 4, 2048, 16],
    [3, 9000, 2, 2048, 9],
  ])(
    "of %i x %i pixels with %i samples a side, in textures of %i, fit",
    (width, height, samples, side, count) => {
      const tiles = tilesOf(width, height, samples, side);
      if (count !== null) expect(tiles.length).toBe(count);
      let area = 0;
      for (const tile of tiles) {
        expect(Math.max(tile.width, tile.height) * samples).toBeLessThanOrEqual(side);
        expect(tile.width * tile.height * samples ** 2).toBeLessThanOrEqual(mostSamples);
        expect(tile.left + tile.width).toBeLessThanOrEqual(width);
        expect(tile.top + tile.height).toBeLessThanOrEqual(height);
        area += tile.width * tile.height;
      }
      // None lies over another: they are rows and columns.
      expect(new Set(tiles.map(({ left, top }) => `${left} ${top}`)).size).toBe(tiles.length);
      expect(area).toBe(width * height);
    },
  );
});
