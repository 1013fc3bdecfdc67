import { describe, expect, it } from "vitest";
import { directionOfPixel } from "../src/engine/environment.js";
import type { EnvironmentMap } from "../src/engine/environmentMap.js";
import { presetMap } from "../src/light/presets.js";
import { ballPicture, smallMap } from "../src/light/thumbnail.js";

const side = 32;

/** A map with light around one direction only. */
function lamp(x: number, y: number, z: number, radiance: readonly number[]): EnvironmentMap {
  const [height, width] = [32, 64];
  const radianceRgb = new Float32Array(3 * height * width);
  for (let pixel = 0; pixel < height * width; pixel++) {
    const direction = directionOfPixel(Math.floor(pixel / width), pixel % width, height, width);
    if (direction[0] * x + direction[1] * y + direction[2] * z > 0.8) radianceRgb.set(radiance, 3 * pixel);
  }
  return { height, width, radianceRgb };
}

const level = (pixels: Uint8ClampedArray, row: number, column: number, channel = 1): number =>
  pixels[4 * (row * side + column) + channel]!;

describe("the small picture of a light", () => {
  it("is a ball on nothing", () => {
    const pixels = ballPicture(presetMap("even"), side);
    expect(level(pixels, 0, 0, 3)).toBe(0);
    expect(level(pixels, side / 2, side / 2, 3)).toBe(255);
    const covered = pixels.reduce((sum, value, index) => sum + (index % 4 === 3 ? value / 255 : 0), 0);
    expect(covered / side ** 2).toBeGreaterThan(0.7);
    expect(covered / side ** 2).toBeLessThan(Math.PI / 4);
  });
  it("is bright where the light comes from, seen from the viewer's first camera", () => {
    const [cos, sin] = [Math.cos(Math.PI / 6), Math.sin(Math.PI / 6)];
    const above = ballPicture(lamp(0, 0, 1, [5, 5, 5]), side);
    expect(level(above, 4, 16)).toBeGreaterThan(2 * level(above, 27, 16));
    // From azimuth 30, +y turned by as much is on the right.
    const right = ballPicture(lamp(-sin, cos, 0, [5, 5, 5]), side);
    expect(level(right, 16, 27)).toBeGreaterThan(2 * level(right, 16, 4));
  });
  it("has the light's colour, and is as bright under a weak light as under a strong one", () => {
    const red = ballPicture(lamp(0.6, 0.3, 0.74, [4, 1, 0.5]), side);
    expect(level(red, 10, 16, 0)).toBeGreaterThan(1.5 * level(red, 10, 16, 2));
    const [weak, strong] = [0.01, 100].map((value) =>
      ballPicture(lamp(0.6, 0.3, 0.74, [value, value, value]), side),
    );
    expect(Math.abs(level(weak!, 12, 16) - level(strong!, 12, 16))).toBeLessThanOrEqual(1);
    expect(level(weak!, 12, 16)).toBeGreaterThan(60);
  });
  it("of no light at all is black", () => {
    const dark = ballPicture({ height: 2, width: 4, radianceRgb: new Float32Array(24) }, side);
    expect([level(dark, 16, 16), level(dark, 16, 16, 3)]).toEqual([0, 255]);
  });
  it("is the same for a small version of the map", () => {
    const map = presetMap("sunset");
    const small = smallMap(map);
    expect([small.width, small.height]).toEqual([128, 64]);
    const [fine, coarse] = [ballPicture(map, side), ballPicture(small, side)];
    const away = fine.reduce((sum, value, index) => sum + Math.abs(value - coarse[index]!), 0) / fine.length;
    expect(away).toBeLessThan(1.5);
  });
});
