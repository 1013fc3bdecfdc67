import { describe, expect, it } from "vitest";
import type { Direction } from "../src/engine/environment.js";
import { project } from "../src/engine/harmonics.js";
import { prepareLight } from "../src/light/prepare.js";
import { presetMap } from "../src/light/presets.js";
import { turnMatrix } from "../src/render/light.js";
import { mainDirection, turned, turnedAbout } from "../src/viewer/turning.js";

const turn = { yawDeg: 40, pitchDeg: -25, rollDeg: 70, intensity: 2 };
const flatOf = (of: typeof turn) => turnMatrix(of).flat();

describe("the main light", () => {
  it("is the sun where there is one", () => {
    const [azimuth, elevation] = [Math.PI / 6, (50 * Math.PI) / 180];
    const sun = [Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation)];
    const found = mainDirection(prepareLight(presetMap("sky"), 4, 4))!;
    expect(found[0]).toBeCloseTo(sun[0]!, 1);
    expect(found[1]).toBeCloseTo(sun[1]!, 1);
    expect(found[2]).toBeCloseTo(Math.sin(elevation), 1);
  });
  it("is where most comes from without one, and nowhere where all is alike", () => {
    const plainRgb = new Float64Array(project(presetMap("sunset"), 3));
    const found = mainDirection({ lights: [], plainRgb })!;
    expect(Math.hypot(...found)).toBeCloseTo(1, 9);
    expect(found[0]).toBeGreaterThan(0.8);
    const even = new Float64Array(project(presetMap("even"), 3));
    expect(mainDirection({ lights: [], plainRgb: even })).toBeNull();
  });
});

describe("turning the light about an axis", () => {
  it("adds to the yaw about +z", () => {
    const after = turnedAbout(turn, [0, 0, 1], 30);
    expect(after.yawDeg).toBeCloseTo(70, 9);
    expect(after.pitchDeg).toBeCloseTo(-25, 9);
    expect(after.rollDeg).toBeCloseTo(70, 9);
    expect(after.intensity).toBe(2);
  });
  it("turns every direction about it, and comes back", () => {
    const axis: Direction = [0.6, 0, 0.8];
    const after = turnedAbout(turn, axis, 120);
    const thrice = turnedAbout(turnedAbout(after, axis, 120), axis, 120);
    flatOf(thrice).forEach((value, index) => {
      expect(value).toBeCloseTo(flatOf(turn)[index]!, 9);
    });
    // What lies along the axis stays.
    const inverse = turnMatrix(turn);
    const along: Direction = [0, 1, 2].map(
      (c) => inverse[0][c as 0] * axis[0] + inverse[1][c as 0] * axis[1] + inverse[2][c as 0] * axis[2],
    ) as unknown as Direction;
    turned(along, after).forEach((value, index) => {
      expect(value).toBeCloseTo(axis[index]!, 9);
    });
  });
  it("continues where yaw and roll are one turn", () => {
    const level = { yawDeg: 0, pitchDeg: 0, rollDeg: 0, intensity: 1 };
    const up = turnedAbout(level, [0, 1, 0], 90);
    expect(up.pitchDeg).toBeCloseTo(90, 6);
    const further = turnedAbout(up, [0, 0, 1], 35);
    const [x, y, z] = turned([0, 0, 1], further);
    expect([x, y, z].map((value) => Number(value.toFixed(6)))).toEqual([
      Number(Math.cos((35 * Math.PI) / 180).toFixed(6)),
      Number(Math.sin((35 * Math.PI) / 180).toFixed(6)),
      0,
    ]);
  });
});
