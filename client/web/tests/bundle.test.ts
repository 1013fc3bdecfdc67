import { BundleFault, MapFault, toldOf } from "../src/page/fault.js";
import { createHash } from "node:crypto";
import { describe, expect, it, vi } from "vitest";
import { type LoadedBundle, loadBundle } from "../src/bundle/load.js";
import { checkPath, openBundle } from "../src/bundle/manifest.js";
import { meshFromGlb } from "../src/bundle/mesh.js";
import { sha256Hex } from "../src/page/buffers.js";
import { openSource } from "../src/bundle/source.js";
import { blocksAround, spreadTexels } from "../src/bundle/texels.js";
import { tableWidth, forHits } from "../src/bundle/transport.js";
import { readUncertainty } from "../src/bundle/uncertainty.js";
import {
  allFiles,
  frames,
  listFiles,
  pictures,
  pngHead,
  sourceOf,
  type TinyBundle,
  tinyBundle,
  triangleGlb,
  zipOf,
} from "./support/bundle.js";

async function faultOf(work: Promise<unknown>): Promise<BundleFault> {
  try {
    await work;
  } catch (error) {
    if (error instanceof BundleFault) return error;
    throw error;
  }
  throw new Error("nothing was refused");
}

async function open(bundle: TinyBundle, listed = true): Promise<unknown> {
  if (listed) listFiles(bundle);
  const archive = zipOf(allFiles(bundle));
  return loadBundle({ kind: "archive", file: new Blob([archive]) }, () => {}, decoded);
}

/** Stands for a decoder, which Node lacks: the "picture" is the file's last byte; no byte cannot be decoded. */
async function decoded(png: Uint8Array<ArrayBuffer>): Promise<ImageBitmap> {
  if (png.length <= pngHead(1, 1).length) throw new Error("nothing to decode");
  return { width: png.at(-1)! } as ImageBitmap;
}

/** Return a bundle with other pictures: what `pngHead` makes of a size, and a byte. */
function textured(baseColour = pictures[0]!, packed = pictures[1]!): TinyBundle {
  const bundle = tinyBundle();
  const files = [baseColour, packed, pictures[2]!];
  bundle.files.set("mesh/asset.glb", triangleGlb(undefined, undefined, files));
  return bundle;
}

describe("digests", () => {
  it.each([0, 1, 55, 56, 63, 64, 119, 1000])("of %i bytes are SHA-256", async (length) => {
    const data = Uint8Array.from({ length }, (_, index) => (index * 31) & 255);
    const expected = createHash("sha256").update(data).digest("hex");
    expect(await sha256Hex(data)).toBe(expected);
    // Pages that came over plain HTTP have no subtle one.
    vi.stubGlobal("crypto", {});
    expect(await sha256Hex(data)).toBe(expected);
    vi.unstubAllGlobals();
  });
});

describe("a bundle", () => {
  it("is read from stored and from deflated archives, and from dropped files", async () => {
    const files = allFiles(tinyBundle());
    const inFolder = new Map(
      [...files].map(([path, data]) => [`some/tiny.relight/${path}`, new Blob([data])]),
    );
    const origins = [
      { kind: "archive", file: new Blob([zipOf(files)]) },
      { kind: "archive", file: new Blob([zipOf(files, { packed: true })]) },
      { kind: "files", files: inFolder },
    ] as const;
    for (const origin of origins) {
      const shares: number[] = [];
      const bundle = await loadBundle(
        origin,
        (news) => {
          if (news.kind === "progress") shares.push(news.readBytes / news.totalBytes);
        },
        decoded,
      );
      expect(bundle.name).toBe("tiny");
      expect(shares.at(-1)).toBe(1);
      expect([...bundle.mesh.indices]).toEqual([0, 1, 2]);
      const { manifest, read } = await openBundle(await openSource(origin));
      const { shadowBits } = await forHits(bundle.transport, manifest.transport!, read);
      const { direct, coarseOfTexel } = bundle.transport;
      // One plane: the first of four in its layer; the second texel is the second value of the file.
      expect([direct.steps[0], direct.steps[4], direct.steps[1]]).toEqual([0, 7, 0]);
      expect(direct.steps.length).toBe(4 * tableWidth);
      // Texels 0, 1, 4, 5 share the first block of 2 x 2.
      expect([...coarseOfTexel.subarray(0, 6)]).toEqual([0, 0, 0, 0, 1, 2]);
      // Byte 16 of texel 1's 32 is the lowest byte of the second layer's first word.
      expect(shadowBits![4 * tableWidth + 4]! & 255).toBe((32 + 16) % 251);
    }
  });

  it("has the mesh's textures for materials", async () => {
    const bundle = (await open(tinyBundle())) as LoadedBundle;
    const { albedo, packed, normal } = bundle.maps;
    expect([albedo.width, packed.width, normal.width]).toEqual([7, 5, 6]);
    for (const picture of [[1, 2, 3], pngHead(8, 8), [...pngHead(8, 8).slice(0, 16), 7]]) {
      expect((await faultOf(open(textured(picture)))).code).toBe("bundle.mesh_invalid");
    }
    const without = tinyBundle();
    without.files.set("mesh/asset.glb", triangleGlb(undefined, undefined, []));
    expect((await faultOf(open(without))).code).toBe("bundle.mesh_invalid");
  });

  it.each([
    [8193, 1, "more than 8192 a side"],
    [2 ** 31 - 1, 2 ** 31 - 1, "more than 8192 a side"],
    [0, 8, "0 x 8"],
    [16, 16, "the manifest states 8 a side"],
    [8, 4, "the manifest states 8 a side"],
  ])("decodes no picture of %i x %i texels", async (width, height, told) => {
    const bundle = textured([...pngHead(width, height), 7]);
    listFiles(bundle);
    const archive = { kind: "archive", file: new Blob([zipOf(allFiles(bundle))]) } as const;
    const never = async (): Promise<ImageBitmap> => {
      throw new Error("it was decoded");
    };
    const fault = await faultOf(loadBundle(archive, () => {}, never));
    expect(fault.code).toBe("bundle.mesh_invalid");
    expect(fault.message).toContain(told);
    const other = textured(undefined, [...pngHead(width, height), 5]);
    expect((await faultOf(open(other))).code).toBe("bundle.mesh_invalid");
  });

  it.each([
    ["size", 0],
    ["size", 8193],
    ["material_size", 0],
    ["material_size", 2 ** 32 - 1],
    ["texel_size", "NaN"],
    ["texel_size", "Infinity"],
    ["texel_size", -1],
    ["texel_size", 0],
  ])("is refused where the atlas states a %s of %s", async (name, value) => {
    const bundle = tinyBundle();
    (bundle.manifest.atlas as Record<string, unknown>)[name] = value;
    expect((await faultOf(open(bundle))).code).toBe("bundle.manifest_invalid");
  });

  it.each([-1, 1.5, "NaN", 2 ** 32, 1e300])("is refused where a size of the atlas is %s", async (size) => {
    const bundle = tinyBundle();
    (bundle.manifest.atlas as Record<string, unknown>).size = size;
    expect((await faultOf(open(bundle))).code).toBe("bundle.manifest_unreadable");
  });

  it.each(["shadow_bits", "material"])(
    "has %s of the right length, or they are refused when they are read",
    async (name) => {
      const bundle = tinyBundle();
      bundle.files.set(`transport/${name}.bin`, new Uint8Array(3));
      listFiles(bundle);
      const origin = { kind: "archive", file: new Blob([zipOf(allFiles(bundle))]) } as const;
      const { transport } = await loadBundle(origin, () => {}, decoded);
      const { manifest, read } = await openBundle(await openSource(origin));
      const fault = await faultOf(forHits(transport, manifest.transport!, read));
      expect(fault.code).toBe("bundle.transport_invalid");
    },
  );

  it("is refused with the reader's codes", async () => {
    const cases: [string, (bundle: TinyBundle) => void][] = [
      [
        "bundle.convention_unknown",
        ({ manifest }) => ((manifest.world as { up_axis: string }).up_axis = "y"),
      ],
      ["bundle.manifest_invalid", ({ manifest }) => (manifest.albedo_scale_rgb = [1, 0, 1])],
      [
        "bundle.manifest_invalid",
        ({ manifest }) => (manifest.bounds = { minimum: [1, 1, 1], maximum: [1, 1, 1] }),
      ],
      ["bundle.transport_invalid", ({ files }) => files.set("transport/texels.bin", new Uint8Array(3))],
      ["bundle.transport_invalid", ({ files }) => files.set("transport/direct_sh7.bin", new Uint8Array(3))],
      [
        "bundle.transport_invalid",
        ({ manifest }) => ((manifest.transport as Record<string, unknown>).num_shadow_directions = 128),
      ],
      ["bundle.transport_missing", ({ manifest }) => delete manifest.transport],
      ["bundle.manifest_invalid", ({ manifest }) => delete manifest.atlas],
      ["bundle.mesh_invalid", ({ files }) => files.set("mesh/asset.glb", new Uint8Array(64))],
      ["bundle.mesh_invalid", ({ files }) => files.set("mesh/asset.glb", triangleGlb(undefined, [0, 1, 3]))],
      [
        "bundle.mesh_invalid",
        ({ files }) => files.set("mesh/asset.glb", triangleGlb([Number.NaN, 0, 0, 1, 0, 0, 0, 1, 0])),
      ],
    ];
    for (const [code, spoil] of cases) {
      const bundle = tinyBundle();
      spoil(bundle);
      expect((await faultOf(open(bundle))).code, spoil.toString()).toBe(code);
    }
  });

  it.each(["2", "1.3", "0", ""])("of version %j is refused with what to do", async (version) => {
    const bundle = tinyBundle();
    bundle.manifest.schema_version = version;
    const fault = await faultOf(open(bundle));
    expect(fault.code).toBe("bundle.version_unknown");
    expect(fault.message).toContain(`format version "${version}", this viewer reads version "1" alone`);
    expect(fault.message).toContain("export the bundle again");
  });

  it("is refused when files and manifest disagree", async () => {
    const changed = tinyBundle();
    changed.files.get("transport/direct_sh7.bin")![0]! += 1;
    expect((await faultOf(open(changed, false))).code).toBe("bundle.digest_mismatch");
    const less = tinyBundle();
    less.files.delete("transport/material.bin");
    expect((await faultOf(open(less, false))).code).toBe("bundle.file_missing");
    const more = tinyBundle();
    more.files.set("extra.txt", new Uint8Array(1));
    expect((await faultOf(open(more, false))).code).toBe("bundle.file_unlisted");
  });

  it("may have fields that a reader does not know", async () => {
    const bundle = tinyBundle();
    bundle.manifest.something_new = { deep: true };
    expect((await openBundle(sourceOf(bundle))).manifest.name).toBe("tiny");
  });
});

describe("an archive", () => {
  const origin = (data: Uint8Array<ArrayBuffer>) => ({ kind: "archive", file: new Blob([data]) }) as const;

  it("is refused when it is damaged, encrypted or no archive", async () => {
    const whole = zipOf(allFiles(tinyBundle()));
    const cases: [string, Uint8Array<ArrayBuffer>][] = [
      ["bundle.archive_damaged", new Uint8Array(100)],
      ["bundle.archive_damaged", whole.slice(0, whole.length - 30)],
      ["bundle.encrypted", zipOf(allFiles(tinyBundle()), { flags: 1 })],
    ];
    for (const [code, data] of cases) expect((await faultOf(openSource(origin(data)))).code).toBe(code);
    const empty = await faultOf(loadBundle(origin(zipOf(new Map())), () => {}, decoded));
    expect(empty.code).toBe("bundle.manifest_missing");
  });
});

describe("paths", () => {
  it.each(["", "/a", "a//b", "../a", "a/../b", "a\\b", "C:a", "a/./b", "a\0b"])("refuses %j", (path) => {
    expect(() => checkPath(path)).toThrow(/leads out of the bundle/);
  });
  it("lets plain ones pass", () => {
    checkPath("models/gbuffer.onnx");
  });
});

describe("the mesh", () => {
  it("has the file's normals and tangents, which must fit", () => {
    const read = (given: typeof frames) => meshFromGlb(triangleGlb(undefined, undefined, [], given));
    expect([...read(frames).normalsXyz]).toEqual(frames.normals);
    expect([...read(frames).tangentsXyzw]).toEqual(frames.tangents);
    for (const spoilt of [
      { ...frames, normals: frames.normals.slice(0, 6) },
      { ...frames, tangents: frames.tangents.map((value, index) => (index === 5 ? Number.NaN : value)) },
    ]) {
      expect(() => read(spoilt)).toThrow("normals or tangents that do not fit");
    }
  });

  it("has the file's positions and texture coordinates", () => {
    const mesh = meshFromGlb(triangleGlb());
    expect([...mesh.positionsXyz]).toEqual([0, 0, 0, 1, 0, 0, 0, 1, 0]);
    expect([...mesh.uv]).toEqual([0, 0, 1, 0, 0, 1]);
  });
});

describe("the uncertainty grid", () => {
  const stated = {
    path: "",
    channels: ["views", "albedo"],
    box: { minimum: [0, 0, 0], maximum: [1, 1, 1] },
  } as unknown as Parameters<typeof readUncertainty>[0];
  const npy = (values: number[]): Uint8Array<ArrayBuffer> => {
    const text = "{'descr': '<f2', 'fortran_order': False, 'shape': (1, 2, 3, 2), }".padEnd(117, " ");
    const head = [0x93, ...Buffer.from("NUMPY"), 1, 0, 118, 0, ...Buffer.from(`${text}\n`)];
    return Uint8Array.from([...head, ...Buffer.from(Uint16Array.from(values).buffer)]);
  };

  it("gives one channel, x fastest", () => {
    const grid = readUncertainty(stated, npy(Array.from({ length: 12 }, (_, index) => index)));
    expect(grid.counts).toEqual([1, 2, 3]);
    // [x][y][z][channel]: the channel of (0, y, z) is 6 y + 2 z + 1.
    expect([...grid.albedoHalf]).toEqual([1, 7, 3, 9, 5, 11]);
  });
  it("is refused with values that are not finite, or another length", () => {
    expect(() => readUncertainty(stated, npy(new Array(12).fill(0x7c00)))).toThrow(/finite/);
    expect(() => readUncertainty(stated, npy(new Array(11).fill(0)))).toThrow(/length/);
    expect(() => readUncertainty(stated, new Uint8Array(200))).toThrow(/NPY/);
  });
});

describe("places outside charts", () => {
  it("have the coarse texels around them, of their own chart", () => {
    // Two charts of 2 x 4 texels, two texels apart: columns 1 and 2, and 5 and 6.
    const places = Array.from({ length: 64 }, (_, place) => place);
    const index = Uint32Array.from(places.filter((place) => [1, 2, 5, 6].includes(place % 8)));
    const plane = spreadTexels(index, 8);
    // Blocks by their place in the atlas of half the size.
    const coarse = index.map((place) => 4 * (Math.floor(place / 8) >> 1) + ((place % 8) >> 1));
    const around = blocksAround(index, plane, coarse, 8);
    const of = (row: number, column: number): number[] => {
      const texel = index.indexOf(8 * row + column);
      return [...around.subarray(4 * texel, 4 * texel + 4)];
    };
    expect(of(3, 2)).toEqual([5, 4, 9, 8]);
    expect(of(2, 1)).toEqual([4, 5, 0, 1]);
    // To the right of column 6 and left of column 5 is the chart itself, or its last texel again.
    expect(of(0, 5)).toEqual([2, 3, 2, 3]);
    expect(of(7, 6)).toEqual([15, 14, 15, 14]);
  });

  it("take the nearest covered texel", () => {
    const owner = spreadTexels(Uint32Array.from([0, 15]), 4);
    expect([...owner]).toEqual(
      [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1, 1].map((_value, place) => {
        const [row, column] = [Math.floor(place / 4), place % 4];
        const [first, second] = [row ** 2 + column ** 2, (3 - row) ** 2 + (3 - column) ** 2];
        return first === second ? owner[place] : first < second ? 0 : 1;
      }),
    );
  });
});

describe("what does not fit into memory", () => {
  const unfit = (): unknown => {
    try {
      return new Float64Array(2 ** 52);
    } catch (error) {
      return error;
    }
  };

  it("is reported with its code and message, of bundles and of maps", () => {
    expect(toldOf(unfit(), "bundle", "full")).toEqual({ code: "bundle.memory", message: "full" });
    expect(toldOf(new TypeError("x"), "bundle", "full")).toEqual({ code: "bundle.failed", message: "x" });
    const fault = new MapFault("environment.x", "what; advice");
    expect(toldOf(fault, "environment", "full")).toEqual({ code: "environment.x", message: "what; advice" });
  });
});
