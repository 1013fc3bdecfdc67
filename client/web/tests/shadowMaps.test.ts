import { describe, expect, it } from "vitest";
import type { Direction } from "../src/engine/environment.js";
import { screenProgram } from "../src/render/fullScreen.js";
import { lightAxes, ShadowCaster, ShadowMaps } from "../src/render/shadowMaps.js";
import shadowShare from "../src/render/shaders/shadowShare.glsl?raw";
import { BufferGeometry } from "three";

const dot = (a: Direction, b: Direction): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

describe("shadow maps", () => {
  const directions: Direction[] = [
    [0, 0, 1],
    [0, 0, -1],
    [0.6, 0, 0.8],
    [-0.48, 0.6, -0.64],
  ];

  it.each(directions)("look along a light with axes of a right-handed frame: %f %f %f", (...direction) => {
    const [right, up, towards] = lightAxes(direction);
    expect(towards).toEqual(direction);
    for (const [a, b] of [
      [right, up],
      [right, towards],
      [up, towards],
    ] as const) {
      expect(dot(a, b)).toBeCloseTo(0, 12);
    }
    expect(dot(right, right)).toBeCloseTo(1, 12);
    expect(dot(up, up)).toBeCloseTo(1, 12);
    const across: Direction = [
      right[1] * up[2] - right[2] * up[1],
      right[2] * up[0] - right[0] * up[2],
      right[0] * up[1] - right[1] * up[0],
    ];
    expect(dot(across, towards)).toBeCloseTo(1, 12);
  });

  it("give every uniform that the look-up declares", () => {
    const caster = new ShadowCaster(new BufferGeometry(), { centre: [1, 2, 3], radius: 4 });
    const maps = new ShadowMaps();
    const given = caster.uniforms({ directions, radiiRad: [0.1, 0.2, 0.3, 0.4] }, maps);
    expect(Object.keys(given).sort()).toEqual(Object.keys(screenProgram([shadowShare]).uniforms).sort());
    expect((given.lightTangents as Float32Array)[1]).toBeCloseTo(Math.tan(0.2), 6);
    expect(
      [...(given.lightUp as Float32Array).subarray(6, 9)].map((value) => Math.round(1e6 * value)),
    ).toEqual(lightAxes(directions[2]!)[1].map((value) => Math.round(1e6 * value)));
    maps.dispose();
    caster.dispose();
  });
});
