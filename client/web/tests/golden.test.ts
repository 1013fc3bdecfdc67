import { readdirSync, readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { BundleFault } from "../src/page/fault.js";
import { loadBundle } from "../src/bundle/load.js";
import { openBundle } from "../src/bundle/manifest.js";
import { openSource } from "../src/bundle/source.js";
import { forHits } from "../src/bundle/transport.js";

// Bundles of earlier versions; tests/unit/lambent_relight/bundle/test_bundle_versions.py reads the same.
const folder = new URL("../../../tests/golden/bundles/", import.meta.url);
const names = readdirSync(folder).filter((name) => name.endsWith(".relight.zip"));
// None of them has textures that the viewer reads.
const noPicture = () => Promise.reject(new Error("a picture was decoded"));
const originOf = (name: string) =>
  ({ kind: "archive", file: new Blob([readFileSync(new URL(name, folder))]) }) as const;
const open = (name: string) => loadBundle(originOf(name), () => {}, noPicture);

describe("golden bundles", () => {
  it("are of every version", () => {
    expect(names.map((name) => /_(1\.\d+)/.exec(name)![1]!)).toEqual(
      expect.arrayContaining(["1.0", "1.1", "1.2"]),
    );
  });

  it("of 1.0 have no transport, and are refused for that", async () => {
    await expect(open("boxes_1.0.relight.zip")).rejects.toMatchObject({ code: "bundle.transport_missing" });
    await expect(open("boxes_1.0.relight.zip")).rejects.toBeInstanceOf(BundleFault);
  });

  it.each([
    ["boxes_1.1.relight.zip", 24, 1728, 7, true, 0],
    ["ball_1.2.relight.zip", 600, 1613, 7, true, 2],
    ["ball_1.2_lite.relight.zip", 600, 1766, 5, false, 2],
  ])("%s is read whole", async (name, numFaces, numTexels, bands, hasBits, numMaps) => {
    const bundle = await open(name);
    expect(bundle.mesh.indices.length / 3).toBe(numFaces);
    expect(bundle.transport.numTexels).toBe(numTexels);
    expect(bundle.transport.direct.bands).toBe(bands);
    expect(bundle.transport.shadowBits).toBe(null);
    const { manifest, read } = await openBundle(await openSource(originOf(name)));
    const whole = await forHits(bundle.transport, manifest.transport!, read);
    expect(whole.shadowBits !== null).toBe(hasBits);
    expect(bundle.trainedMaps.length).toBe(numMaps);
    expect(bundle.uncertainty !== null).toBe(numMaps > 0);
    expect(bundle.cameras.length).toBe(1);
  });
});
