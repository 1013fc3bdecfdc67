import { readdirSync, readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { type Decode, loadBundle } from "../src/bundle/load.js";
import { openBundle } from "../src/bundle/manifest.js";
import { openSource } from "../src/bundle/source.js";
import { forHits } from "../src/bundle/transport.js";

// tests/unit/lambent_relight/bundle/test_golden_bundles.py reads the same.
const folder = new URL("../../../tests/golden/bundles/", import.meta.url);
const expected: readonly [
  name: string,
  numFaces: number,
  numTexels: number,
  bands: number,
  hasBits: boolean,
][] = [
  ["ball.relight.zip", 546, 1714, 7, true],
  ["ball_lite.relight.zip", 546, 1713, 5, false],
];
const decode: Decode = async () => ({ width: 1 }) as ImageBitmap;

describe("golden bundles", () => {
  it("are these", () => {
    const names = readdirSync(folder).filter((name) => name.endsWith(".relight.zip"));
    expect(names.sort()).toEqual(expected.map(([name]) => name));
  });

  it.each(expected)("%s is read whole", async (name, numFaces, numTexels, bands, hasBits) => {
    const origin = { kind: "archive", file: new Blob([readFileSync(new URL(name, folder))]) } as const;
    const bundle = await loadBundle(origin, () => {}, decode);
    expect(bundle.mesh.indices.length / 3).toBe(numFaces);
    expect(bundle.transport.numTexels).toBe(numTexels);
    expect(bundle.transport.direct.bands).toBe(bands);
    const { manifest, read } = await openBundle(await openSource(origin));
    const whole = await forHits(bundle.transport, manifest.transport!, read);
    expect(whole.shadowBits !== null).toBe(hasBits);
    expect(bundle.trainedMaps.length).toBe(2);
    expect(bundle.uncertainty).not.toBe(null);
    expect(bundle.cameras.length).toBe(1);
  });
});
