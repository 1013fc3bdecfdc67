import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { directionOfPixel, directionOfUv, type Direction } from "../src/engine/environment.js";
import { rotateAboutZ, uvOfDirection } from "./lookup.js";

type Golden = {
  readonly height: number;
  readonly width: number;
  readonly cases: readonly {
    readonly row: number;
    readonly column: number;
    readonly rotate_deg: number;
    readonly direction: Direction;
    readonly lit_face: string;
  }[];
};

// The same numbers hold in Python (lambent_relight) and in here.
const goldenFile = new URL("../../../tests/golden/environment_orientation.json", import.meta.url);
const golden = JSON.parse(readFileSync(goldenFile, "utf8")) as Golden;

const faces: readonly (readonly [string, Direction])[] = [
  ["+x", [1, 0, 0]],
  ["-x", [-1, 0, 0]],
  ["+y", [0, 1, 0]],
  ["-y", [0, -1, 0]],
  ["+z", [0, 0, 1]],
  ["-z", [0, 0, -1]],
];

function dot(a: Direction, b: Direction): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function expectClose(found: readonly number[], expected: readonly number[], tolerance: number): void {
  expect(found.length).toBe(expected.length);
  found.forEach((value, index) => {
    expect(Math.abs(value - (expected[index] ?? NaN))).toBeLessThanOrEqual(tolerance);
  });
}

describe("environment orientation", () => {
  it("has +z above row 0, +x in column W/2, and azimuth falling to the right", () => {
    expectClose(directionOfUv([0.5, 0]), [0, 0, 1], 1e-12);
    expectClose(directionOfUv([0.5, 0.5]), [1, 0, 0], 1e-12);
    expectClose(directionOfUv([0.25, 0.5]), [0, 1, 0], 1e-12);
    expectClose(directionOfUv([0.75, 0.5]), [0, -1, 0], 1e-12);
  });

  it.each(golden.cases)("row $row, column $column, turned by $rotate_deg lights $lit_face", (one) => {
    const centre = directionOfPixel(one.row, one.column, golden.height, golden.width);
    const turned = rotateAboutZ(centre, one.rotate_deg);
    expectClose(turned, one.direction, 1e-8);
    const brightest = faces.reduce((best, face) =>
      dot(face[1], turned) > dot(best[1], turned) ? face : best,
    );
    expect(brightest[0]).toBe(one.lit_face);
    const [u, v] = uvOfDirection(rotateAboutZ(turned, -one.rotate_deg));
    expect([Math.floor(v * golden.height), Math.floor(u * golden.width)]).toEqual([one.row, one.column]);
  });
});
