import { describe, expect, it } from "vitest";
import { project } from "../src/engine/harmonics.js";
import { exposureFor } from "../src/light/exposure.js";
import { prepareLight } from "../src/light/prepare.js";
import { presetMap } from "../src/light/presets.js";
import { besidePhotograph, edgeColour } from "../src/viewer/photograph.js";
import { initialState } from "../src/viewer/state.js";
import { mainDirection } from "../src/viewer/turning.js";

describe("the colour behind a photograph", () => {
  const picture = (width: number, height: number, at: (row: number, column: number) => number[]) =>
    Array.from({ length: width * height }, (_, index) => [
      ...at(Math.floor(index / width), index % width),
      255,
    ]).flat();

  it("is that of its edge, whatever is inside", () => {
    const inside = (row: number, column: number) => row > 0 && row < 4 && column > 0 && column < 5;
    const pixels = picture(6, 5, (row, column) => (inside(row, column) ? [9, 200, 3] : [255, 204, 51]));
    expect(edgeColour(pixels, 6, 5)).toEqual([1, 0.8, 0.2]);
  });
  it("is none where there are several", () => {
    expect(
      edgeColour(
        picture(6, 5, (row) => (row < 2 ? [255, 255, 255] : [0, 0, 0])),
        6,
        5,
      ),
    ).toBeNull();
    expect(edgeColour([], 0, 0)).toBeNull();
  });
  it("is behind the relit object, too, which has the photograph's tone", () => {
    const { look } = initialState;
    const beside = besidePhotograph({ ...look, tone: "agx", exposureEv: 0.5 }, [1, 1, 1]);
    expect(beside).toMatchObject({ tone: "linear", background: "colour", backgroundSrgb: [1, 1, 1] });
    expect([beside.autoExposure, beside.exposureEv]).toEqual([false, 0.5]);
    expect(besidePhotograph(look, null).background).toBe("environment");
  });
});

describe("the exposure of a light", () => {
  const exposure = (name: Parameters<typeof presetMap>[0], factor = 1): number => {
    const map = presetMap(name);
    const radianceRgb = map.radianceRgb.map((value) => factor * value);
    const light = prepareLight({ ...map, radianceRgb }, 3, 4);
    return exposureFor(light, mainDirection(light));
  };

  it("brings a grey surface that faces it to the same level", () => {
    // Under even light of radiance 0.8 the surface is 0.4.
    expect(exposure("even")).toBeCloseTo(Math.log2(0.42 / 0.4), 3);
    expect(exposure("even", 0.25)).toBeCloseTo(Math.log2(0.42 / 0.4) + 2, 3);
  });
  it("is lower for the sun than for the studio, and finite for no light", () => {
    expect(exposure("sky")).toBeLessThan(exposure("studio"));
    expect(exposureFor({ plainRgb: new Float64Array(27) }, null)).toBe(0);
    const dim = new Float64Array(project(presetMap("even"), 3)).map((value) => 1e-9 * value);
    expect(exposureFor({ plainRgb: dim }, null)).toBe(10);
  });
});
