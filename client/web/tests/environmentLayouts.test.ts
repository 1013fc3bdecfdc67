import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import type { Direction } from "../src/engine/environment.js";
import { MapFault } from "../src/page/fault.js";
import { type Layout, layoutOfSize, toLatLong } from "../src/light/layouts.js";
import { openEnvironment } from "../src/light/open.js";
import { rec709Matrix, toRec709 } from "../src/light/primaries.js";
import { decodeLines } from "../src/light/rgbeRows.js";
import { lookup } from "./lookup.js";

// Made by tests/support/environment_layouts.py; read by the Python reader in
// tests/unit/lambent_relight/environment/test_layouts.py, too.
const folder = new URL("../../../tests/golden/environments/", import.meta.url);

type Case = {
  readonly file: string;
  readonly given?: Layout;
  readonly read_as?: Layout;
  readonly code?: string;
  readonly coarse?: boolean;
  readonly skip_first?: boolean;
};
const index = JSON.parse(readFileSync(new URL("index.json", folder), "utf8")) as {
  readonly cases: readonly Case[];
  readonly directions: readonly Direction[];
  readonly radiance: readonly number[][];
};

function open({ file, given }: Case) {
  return openEnvironment(new Uint8Array(readFileSync(new URL(file, folder))), 1 << 20, given);
}

describe("environment maps in all layouts and codings", () => {
  it.each(index.cases.filter((each) => each.read_as !== undefined))(
    "$file has the known radiance",
    async (each) => {
      const map = await open(each);
      expect(map.readAs).toBe(each.read_as);
      expect(map.notes.length).toBe(each.read_as === "latlong" ? 0 : 1);
      if (each.skip_first) {
        for (const row of [0, 5])
          map.radianceRgb.copyWithin(3 * row * map.width, 3 * row * map.width + 3, 3 * row * map.width + 6);
      }
      // The rim of a probe is what is behind; coarse maps interpolate badly at the poles.
      const least = map.readAs === "angular" ? -0.98 : map.readAs === "mirror-ball" ? -0.7 : -1.1;
      let worst = 0;
      index.directions.forEach((direction, at) => {
        if (direction[0] <= least || (each.coarse && Math.abs(direction[2]) >= 0.8)) return;
        lookup(map, direction).forEach((value, channel) => {
          worst = Math.max(worst, Math.abs(value - index.radiance[at]![channel]!));
        });
      });
      expect(worst).toBeLessThan(each.coarse ? 0.06 : 0.03);
    },
  );

  it.each(index.cases.filter((each) => each.code !== undefined))("$file is refused by name", async (each) => {
    const refused = await open(each).then(
      () => null,
      (error: unknown) => error,
    );
    expect(refused).toBeInstanceOf(MapFault);
    expect((refused as MapFault).code).toBe(each.code);
  });

  it("are recognised by the same sizes as in Python", () => {
    const sizes = [
      [512, 1024, "latlong"],
      [1, 1, "latlong"],
      [500, 1010, "latlong"],
      [300, 400, "cross-horizontal"],
      [400, 300, "cross-vertical"],
      [64, 384, "strip-horizontal"],
      [384, 64, "strip-vertical"],
      [200, 200, "angular"],
      [200, 300, null],
      [301, 401, null],
    ] as const;
    for (const [height, width, layout] of sizes) expect(layoutOfSize(height, width)).toBe(layout);
  });

  it("have no seams and are at most as wide as asked", () => {
    const map = { height: 8, width: 48, radianceRgb: new Float32Array(3 * 8 * 48).fill(1) };
    const found = toLatLong(map, "strip-horizontal", 16);
    expect([found.height, found.width]).toEqual([8, 16]);
    for (const value of found.radianceRgb) expect(value).toBeCloseTo(1, 5);
  });

  it("lose unusable values before these spread", async () => {
    const file = new Uint8Array(readFileSync(new URL("strip_horizontal.exr", folder)));
    const map = await openEnvironment(file, 1 << 20);
    const picture = { height: 16, width: 96, radianceRgb: new Float32Array(3 * 16 * 96).fill(1) };
    picture.radianceRgb[100] = Number.NaN;
    const spread = toLatLong(picture, "strip-horizontal", 64).radianceRgb.filter((value) => !(value >= 0));
    expect(spread.length).toBeGreaterThan(1);
    expect(map.radianceRgb.every((value) => value >= 0)).toBe(true);
  });
});

describe("primaries", () => {
  it("adapt tristimulus values to no white", () => {
    const found = rec709Matrix([1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3])!;
    // Source: IEC 61966-2-1, the matrix from XYZ to linear sRGB.
    const expected = [3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.204, 1.057];
    expect(
      found
        .transpose()
        .toArray()
        .map((value, at) => Math.abs(value - expected[at]!))
        .every((off) => off < 1e-3),
    ).toBe(true);
  });

  it("keep grey grey, and are null for those of Rec. 709", () => {
    const aces = rec709Matrix([0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767]);
    const rgb = Float32Array.of(1, 1, 1, -1, 0, 0);
    toRec709(rgb, aces ?? null);
    for (const value of rgb.slice(0, 3)) expect(value).toBeCloseTo(1, 5);
    expect(Math.min(...rgb.slice(3))).toBeLessThan(0);
    expect(rec709Matrix([0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.313, 0.329])).toBeNull();
    expect(rec709Matrix([0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3])).toBeUndefined();
    expect(rec709Matrix([0.64, 0.33])).toBeUndefined();
  });
});

describe("lines of Radiance pictures", () => {
  it("may repeat into the next line, as old writers let them", () => {
    const found = decodeLines(Uint8Array.of(10, 20, 30, 130, 1, 1, 1, 19), 2, 10);
    expect([...found]).toEqual(Array.from({ length: 20 }, () => [10, 20, 30, 130]).flat());
  });
  it("that are damaged are not taken for flat pixels", () => {
    const line = [2, 2, 0, 8, 0, ...Array.from({ length: 40 }, (_, at) => at)];
    expect(() => decodeLines(Uint8Array.from(line), 1, 8)).toThrow();
  });
});
