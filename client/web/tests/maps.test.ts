import { readFileSync } from "node:fs";
import { deflateSync } from "node:zlib";
import { describe, expect, it } from "vitest";
import { numLevels, numLobeSteps } from "../src/contract/constants.js";
import { energy } from "../src/engine/environmentMap.js";
import { sumFactors } from "../src/engine/fallingLight.js";
import { cosineFactors } from "../src/engine/harmonics.js";
import { ggxBands } from "../src/engine/lobes.js";
import { shadowDirections, shadowWeights } from "../src/engine/shadows.js";
import { checkHeader, shownOf, statedBy } from "../src/light/exrHeader.js";
import { decodedByThree, readExr } from "../src/light/exrInput.js";
import { MapFault } from "../src/page/fault.js";
import { halfValue, toHalf } from "../src/engine/half.js";
import { maxDominant, prepareLight, usableMap } from "../src/light/prepare.js";
import { presetMap, presetNames } from "../src/light/presets.js";
import { readRgbe } from "../src/light/rgbe.js";
import { encodeExr } from "../src/viewer/save.js";
import { turnMatrix } from "../src/render/light.js";

async function codeOf(work: () => unknown): Promise<string> {
  try {
    await work();
  } catch (error) {
    if (error instanceof MapFault) return error.code;
    throw error;
  }
  return "nothing was refused";
}

function hdr(header: string, pixels: readonly number[]): Uint8Array<ArrayBuffer> {
  return Uint8Array.from([...Buffer.from(header), ...pixels]);
}

describe("half floats", () => {
  it("are the nearest ones, and come back", () => {
    const halves = Array.from({ length: 0x7c00 }, (_, half) => half);
    expect(halves.every((half) => toHalf(halfValue(half)) === half)).toBe(true);
    expect(halves.slice(1).every((half) => toHalf(-halfValue(half)) === (half | 0x8000))).toBe(true);
    // Just below and above the middle between two neighbours.
    const [low, high] = [halfValue(0x3c00), halfValue(0x3c01)];
    expect(toHalf(low + 0.49 * (high - low))).toBe(0x3c00);
    expect(toHalf(low + 0.51 * (high - low))).toBe(0x3c01);
    expect(halfValue(toHalf(1e9))).toBe(65504);
  });
});

describe("Radiance maps", () => {
  const head = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n";

  it("are decoded flat, mirrored, and divided by EXPOSURE", () => {
    const pixels = [128, 64, 32, 129, 0, 0, 0, 0];
    const map = readRgbe(hdr(`${head}EXPOSURE=2\n\n-Y 1 +X 2\n`, pixels), 100);
    expect([...map.radianceRgb]).toEqual([0.5, 0.25, 0.125, 0, 0, 0]);
    const mirrored = readRgbe(hdr(`${head}\n-Y 1 -X 2\n`, pixels), 100);
    expect([...mirrored.radianceRgb]).toEqual([0, 0, 0, 1, 0.5, 0.25]);
  });
  it("repeat pixels in the old format", () => {
    const map = readRgbe(hdr(`${head}\n-Y 1 +X 4\n`, [128, 128, 128, 129, 1, 1, 1, 3]), 100);
    expect([...map.radianceRgb]).toEqual(new Array(12).fill(1));
  });
  it("are decoded from run lengths", () => {
    const line = [
      2,
      2,
      0,
      8,
      ...[128 + 8, 128],
      ...[8, 1, 2, 3, 4, 5, 6, 7, 8],
      ...[128 + 8, 0],
      ...[128 + 8, 136],
    ];
    const map = readRgbe(hdr(`${head}\n-Y 1 +X 8\n`, line), 100);
    expect([...map.radianceRgb.slice(0, 6)]).toEqual([128, 1, 0, 128, 2, 0]);
  });
  it("are refused when they are damaged", async () => {
    const cases: [string, Uint8Array][] = [
      ["environment.hdr_damaged", hdr("nothing", [])],
      ["environment.hdr_damaged", hdr(`${head}\n-Y 2 +X 2\n`, [1, 2, 3, 4])],
      ["environment.hdr_damaged", hdr(`${head}\n+X 2 -Y 2\n`, [])],
      ["environment.hdr_damaged", hdr(`${head}\n-Y 1 +X 8\n`, [2, 2, 0, 8, 255, 1])],
      ["environment.hdr_format", hdr("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n", [1, 1, 1, 1])],
      ["environment.too_large", hdr(`${head}\n-Y 100 +X 100\n`, [])],
    ];
    for (const [code, data] of cases) expect(await codeOf(() => readRgbe(data, 99))).toBe(code);
  });
  it("of the sample scene have the energy that their pixels say", () => {
    const file = new URL("../../python/lambent/sample/envmaps/sunset.hdr", import.meta.url);
    const map = readRgbe(readFileSync(file), 1 << 20);
    expect(map.radianceRgb.length).toBe(3 * map.width * map.height);
    expect(map.radianceRgb.every((value) => value >= 0)).toBe(true);
  });
});

/** Return an EXR file with its lines deflated by 16, from the one that the viewer saves. */
function deflated(plain: Uint8Array<ArrayBuffer>, width: number, height: number): Uint8Array<ArrayBuffer> {
  const name = plain.findIndex(
    (_, at) => Buffer.from(plain.subarray(at, at + 12)).toString() === "compression\0",
  );
  const header = plain.slice(0, plain.length - height * (16 + 8 * width));
  header[name + 12 + 12 + 4] = 3;
  const numChunks = Math.ceil(height / 16);
  const parts: Uint8Array[] = [];
  const table = new DataView(new ArrayBuffer(8 * numChunks));
  let place = header.length + 8 * numChunks;
  // Any order of chunks will do.
  for (let chunk = numChunks - 1; chunk >= 0; chunk--) {
    const rows = Array.from({ length: Math.min(16, height - 16 * chunk) }, (_, line) => {
      const start = plain.length - (height - 16 * chunk - line) * (8 + 8 * width) + 8;
      return [...plain.subarray(start, start + 8 * width)];
    }).flat();
    const halves = [...rows.filter((_, at) => at % 2 === 0), ...rows.filter((_, at) => at % 2 === 1)];
    const packed = deflateSync(
      Uint8Array.from(halves, (value, at) => (at ? value - halves[at - 1]! + 128 : value)),
    );
    const small = packed.length < rows.length;
    const data = small ? packed : Uint8Array.from(rows);
    table.setBigUint64(8 * chunk, BigInt(place), true);
    parts.push(new Uint8Array(Int32Array.of(16 * chunk, data.length).buffer), data);
    place += 8 + data.length;
  }
  return Uint8Array.from(Buffer.concat([header, new Uint8Array(table.buffer), ...parts]));
}

describe("OpenEXR maps", () => {
  const [width, height] = [24, 37];
  const halves = Uint16Array.from({ length: 4 * width * height }, (_, at) => toHalf((at % 97) * 0.37));
  const plain = encodeExr(halves, width, height);
  const packed = deflated(plain, width, height);

  it("are the same deflated or not, and as three decodes them", async () => {
    expect(packed.length).toBeLessThan(0.6 * plain.length);
    const byThree = (file: Uint8Array<ArrayBuffer>) => {
      const shown = checkHeader(statedBy(file, 1000));
      return shownOf(decodedByThree(file, 0, shown), shown);
    };
    const wanted = byThree(plain);
    expect([...wanted.radianceRgb.slice(0, 4)]).toEqual([0, 1, 2, 4].map((at) => halfValue(halves[at]!)));
    expect(await readExr(plain, 1000)).toEqual(wanted);
    expect(await readExr(packed, 1000)).toEqual(wanted);
    expect(byThree(packed)).toEqual(wanted);
  });
  it("are refused when deflated lines are damaged, missing, or more than are stated", async () => {
    const changed = (change: (file: Uint8Array<ArrayBuffer>, view: DataView) => void): (() => unknown) => {
      const file = packed.slice();
      change(file, new DataView(file.buffer));
      return () => readExr(file, 1000);
    };
    const table = plain.length - height * (16 + 8 * width);
    const cases = [
      changed((file) => file.fill(0xff, file.length - 40)),
      changed((file) => file.copyWithin(table, table + 8, table + 16)),
      changed((_, view) => view.setBigUint64(table, 1n << 40n, true)),
      changed((file, view) => {
        for (const name of ["dataWindow", "displayWindow"]) {
          const value = Buffer.from(file).indexOf(`${name}\0box2i\0`) + name.length + 1 + 6 + 4;
          view.setInt32(value + 8, width - 2, true);
        }
      }),
    ];
    for (const read of cases) expect(await codeOf(read)).toBe("environment.exr_damaged");
  });
  it("are refused when they are damaged or too large", { timeout: 60_000 }, async () => {
    expect(await codeOf(() => readExr(new Uint8Array(100), 100))).toBe("environment.exr_damaged");
    const whole = encodeExr(new Uint16Array(4 * 8 * 4), 8, 4);
    expect((await readExr(whole, 32)).width).toBe(8);
    expect(await codeOf(() => readExr(whole, 31))).toBe("environment.too_large");
    // Wherever a file ends early, and whatever byte of its header is another one, an answer comes.
    for (let length = 0; length < 420; length += 7) {
      expect(await codeOf(() => readExr(whole.slice(0, length), 100)), `${length} bytes`).toMatch(
        /^environment/,
      );
    }
    for (let place = 8; place < 300; place++) {
      const changed = whole.slice();
      changed[place] = 0x41;
      expect(await codeOf(() => readExr(changed, 100))).toMatch(/^(environment|nothing)/);
    }
  });
});

describe("a prepared light", () => {
  it("keeps the energy of a constant map and fits its levels beside each other", { timeout: 60_000 }, () => {
    const map = { height: 8, width: 16, radianceRgb: new Float32Array(3 * 8 * 16).fill(0.5) };
    const light = prepareLight(map, 5, maxDominant);
    expect(light.lights.length).toBe(0);
    expect(light.coefficientsRgb[0]).toBeCloseTo(0.5 * Math.sqrt(4 * Math.PI), 6);
    expect(light.plainRgb[0]! * cosineFactors(1)[0]! * Math.sqrt(0.25 / Math.PI)).toBeCloseTo(
      0.5 * Math.PI,
      6,
    );
    expect(light.levels.places.length).toBe(numLevels);
    const covered = new Uint8Array(light.levels.width * light.levels.height);
    let worst = 0;
    for (const [x, y, width, height] of light.levels.places) {
      for (let row = y; row < y + height; row++) {
        for (
          let place = row * light.levels.width + x;
          place < row * light.levels.width + x + width;
          place++
        ) {
          covered[place]! += 1;
          worst = Math.max(worst, Math.abs(halfValue(light.levels.halfRgba[4 * place]!) - 0.5));
        }
      }
    }
    expect(worst).toBeLessThan(1e-3);
    expect(covered.every((count) => count <= 1)).toBe(true);
  });
  it("replaces unusable values and says so", async () => {
    const radianceRgb = new Float32Array(3 * 4 * 8).fill(1);
    radianceRgb.set([Number.NaN, -1, Number.POSITIVE_INFINITY]);
    const { map, notes } = usableMap({ height: 4, width: 8, radianceRgb });
    expect([...map.radianceRgb.subarray(0, 4)]).toEqual([0, 0, 1, 1]);
    expect(notes.join()).toContain("3 negative, infinite or NaN values");
    const none = { height: 1, width: 1, radianceRgb: new Float32Array(3).fill(-1) };
    expect(await codeOf(() => usableMap(none))).toBe("environment.no_values");
  });
  it("reduces large maps and says so", () => {
    const map = { height: 8, width: 4096, radianceRgb: new Float32Array(3 * 8 * 4096).fill(1) };
    const { map: reduced, notes } = usableMap(map);
    expect([reduced.width, reduced.height]).toEqual([2048, 4]);
    expect(notes.join()).toContain("2048 x 4");
  });
  it.each(presetNames)("of the preset %s has light", (name) => {
    const map = presetMap(name);
    expect(energy(map)[1]).toBeGreaterThan(2);
  });
});

describe("the lobe's factors", () => {
  it("are one in band 0, fall with the band, and fall with roughness", () => {
    const table = ggxBands(4);
    for (let step = 0; step < numLobeSteps; step++) {
      const row = table.subarray(4 * step, 4 * step + 4);
      expect(row[0]).toBeCloseTo(1, 6);
      expect(row[1]! >= row[2]! && row[2]! >= row[3]!).toBe(true);
    }
    expect(table[4 * 40 + 1]).toBeLessThan(table[4 * 20 + 1]!);
    // Roughness 1: D is constant, so the light's density is the cosine over 4 cos(half) ... by quadrature 0.6667.
    expect(table[4 * 63 + 1]).toBeCloseTo(2 / 3, 3);
  });
});

describe("shadow weights", () => {
  const stored = shadowDirections(256);

  it("sum to one and belong to the nearest directions", () => {
    const direction = [0.36, -0.48, 0.8] as const;
    const { indices, weights } = shadowWeights(stored, direction);
    expect(weights.reduce((sum, weight) => sum + weight, 0)).toBeCloseTo(1, 12);
    expect(weights.at(-1)).toBe(0);
    const cosine = (index: number): number =>
      stored[index]!.reduce((sum, value, axis) => sum + value * direction[axis]!, 0);
    const sorted = stored.map((_, index) => index).sort((a, b) => cosine(b) - cosine(a));
    expect(indices).toEqual(sorted.slice(0, 6));
  });
});

describe("sums over planes", () => {
  it("put the offset into a constant and the scale into the factors", () => {
    const table = {
      ...{ bands: 1, layers: 1, rows: 1, steps: new Int8Array(4096) },
      ...{ scales: Float32Array.of(2, 3, 4, 0), offsets: Float32Array.of(10, 20, 30, 0) },
    };
    const one = sumFactors(table, [1, 2, 3], 1);
    expect([one.red[0], one.green[0], one.blue[0], ...one.base]).toEqual([2, 4, 6, 10, 20, 30]);
    const three = sumFactors(table, [1, 2, 3], 3);
    expect([...three.red, ...three.green, ...three.blue]).toEqual([2, 0, 0, 0, 0, 6, 0, 0, 0, 0, 12, 0]);
    expect(three.base).toEqual([10, 40, 90]);
  });
});

describe("the turn of a light", () => {
  it("about +z takes light from +x to +y", () => {
    const matrix = turnMatrix({ yawDeg: 90, pitchDeg: 0, rollDeg: 0, intensity: 1 });
    expect(matrix.map((row) => Math.round(row[0]) + 0)).toEqual([0, 1, 0]);
  });
  it("first rolls about +x, then pitches about +y, then turns about +z", () => {
    const matrix = turnMatrix({ yawDeg: 90, pitchDeg: 90, rollDeg: 90, intensity: 1 });
    // +y rolls to +z, pitches to +x, turns to +y.
    expect(matrix.map((row) => Math.round(row[1]) + 0)).toEqual([0, 1, 0]);
  });
});
