/** A tiny bundle in memory: one triangle, an atlas of 4 x 4 texels, one band of transport. */

import { createHash } from "node:crypto";
import { deflateRawSync } from "node:zlib";
import type { FileSource } from "../../src/bundle/source.js";
import { BundleFault } from "../../src/page/fault.js";

type Bytes = Uint8Array<ArrayBuffer>;
export type Manifest = {
  [key: string]: unknown;
  files: { path: string; size_bytes: number; sha256: string }[];
};
export type TinyBundle = { files: Map<string, Bytes>; manifest: Manifest };

const texels = [0, 1, 4, 5, 6, 10];

function bytes(values: ArrayLike<number>): Bytes {
  return Uint8Array.from(values);
}

/** Return the start of a PNG file that states a size. */
export function pngHead(width: number, height: number): number[] {
  const head = Buffer.from(
    `89504e470d0a1a0a0000000d49484452${"00".repeat(8)}0802000000${"00".repeat(4)}`,
    "hex",
  );
  head.writeUInt32BE(width, 16);
  head.writeUInt32BE(height, 20);
  return [...head];
}

/** The files of a base colour, and of the other textures, as the tiny bundle's manifest states them. */
export const pictures: readonly number[][] = [
  [...pngHead(8, 8), 7],
  [...pngHead(4, 4), 5],
  [...pngHead(4, 4), 6],
];

/** Normals and tangents. */
export const frames = {
  normals: [0, 0, 1, 0, 1, 0, 1, 0, 0],
  tangents: [1, 0, 0, 1, 1, 0, 0, 1, 0, 1, 0, -1],
};

/** Return a GLB of one triangle with textures, unless `files` is empty. */
export function triangleGlb(
  positions = [0, 0, 0, 1, 0, 0, 0, 1, 0],
  indices = [0, 1, 2],
  files = pictures,
  { normals, tangents } = frames,
): Bytes {
  const numbers = Buffer.concat([
    Buffer.from(new Float32Array(positions).buffer),
    Buffer.from(new Float32Array([0, 0, 1, 0, 0, 1]).buffer),
    Buffer.from(new Uint32Array(indices).buffer),
  ]);
  const shading = [normals, tangents];
  const floats = shading.map((values) => Buffer.from(new Float32Array(values).buffer));
  const parts = [...files.map((file) => Buffer.from(file)), ...floats];
  const data = Buffer.concat([numbers, ...parts]);
  const views = [
    { buffer: 0, byteOffset: 0, byteLength: 36 },
    { buffer: 0, byteOffset: 36, byteLength: 24 },
    { buffer: 0, byteOffset: 60, byteLength: 12 },
    ...parts.map((part, index) => ({
      buffer: 0,
      byteOffset: numbers.length + Buffer.concat(parts.slice(0, index)).length,
      byteLength: part.length,
    })),
  ];
  const material = {
    pbrMetallicRoughness: { baseColorTexture: { index: 0 }, metallicRoughnessTexture: { index: 1 } },
    normalTexture: { index: 2 },
  };
  const textured = {
    materials: [material],
    textures: files.map((_, index) => ({ source: index })),
    images: files.map((_, index) => ({ bufferView: 3 + index })),
  };
  const accessors = [
    { bufferView: 0, componentType: 5126, count: 3, type: "VEC3" },
    { bufferView: 1, componentType: 5126, count: 3, type: "VEC2" },
    { bufferView: 2, componentType: 5125, count: indices.length, type: "SCALAR" },
    ...shading.map((values, index) => ({
      ...{ bufferView: 3 + files.length + index, componentType: 5126 },
      ...{ count: Math.floor(values.length / (3 + index)), type: index === 0 ? "VEC3" : "VEC4" },
    })),
  ];
  const attributes = { POSITION: 0, TEXCOORD_0: 1, NORMAL: 3, TANGENT: 4 };
  const primitives = [{ attributes, indices: 2 }];
  let text = JSON.stringify({
    meshes: [{ primitives }],
    bufferViews: views,
    accessors,
    ...(files.length > 0 ? textured : {}),
  });
  text += " ".repeat((4 - (text.length % 4)) % 4);
  const head = Buffer.alloc(20);
  [0x46546c67, 2, 28 + text.length + data.length, text.length, 0x4e4f534a].forEach((word, index) => {
    head.writeUInt32LE(word, 4 * index);
  });
  const middle = Buffer.alloc(8);
  middle.writeUInt32LE(data.length, 0);
  middle.writeUInt32LE(0x004e4942, 4);
  return bytes(Buffer.concat([head, Buffer.from(text), middle, data]));
}

/** Return a bundle that every check lets pass. */
export function tinyBundle(): TinyBundle {
  const mask = new Uint8Array(2);
  for (const place of texels) mask[place >> 3]! |= 1 << (place & 7);
  const planes = (count: number, numTexels: number): Bytes =>
    bytes(Array.from({ length: count * numTexels }, (_, index) => (index * 7) % 100));
  const files = new Map<string, Bytes>([
    ["mesh/asset.glb", triangleGlb()],
    ["transport/texels.bin", mask],
    ["transport/direct_sh7.bin", planes(1, 6)],
    ["transport/visibility_sh4.bin", planes(1, 6)],
    ["transport/indirect_sh3.bin", planes(3, 3)],
    ["transport/material.bin", planes(8, 6)],
    ["transport/shadow_bits.bin", bytes(Array.from({ length: 6 * 32 }, (_, index) => index % 251))],
  ]);
  const set = (name: string, path: string, channels: number) => ({
    name,
    path,
    bands: 1,
    channels,
    scales: new Array<number>(channels).fill(0.01),
    offsets: new Array<number>(channels).fill(0.5),
  });
  const manifest: Manifest = {
    schema_version: "1",
    scene_id: "tiny",
    name: "tiny",
    train_lights: [],
    world: {
      up_axis: "z",
      handedness: "right",
      environment_convention: "tensoir",
      radiance: "linear-rec709",
    },
    bounds: { minimum: [-1, -1, -1], maximum: [1, 1, 1] },
    albedo_scale_rgb: [1, 1, 1],
    files: [],
    atlas: {
      ...{ size: 8, material_size: 4, texel_size: 0.1, albedo_source: "photographs" },
    },
    transport: {
      size: 4,
      num_texels: 6,
      texels_path: "transport/texels.bin",
      planes: [
        set("direct", "transport/direct_sh7.bin", 1),
        set("visibility", "transport/visibility_sh4.bin", 1),
        set("indirect", "transport/indirect_sh3.bin", 3),
        set("material", "transport/material.bin", 8),
      ],
      shadow_bits_path: "transport/shadow_bits.bin",
      num_shadow_directions: 256,
    },
  };
  const bundle = { files, manifest };
  listFiles(bundle);
  return bundle;
}

/** Write sizes and digests of the files as they are now into the manifest. */
export function listFiles({ files, manifest }: TinyBundle): void {
  manifest.files = [...files].map(([path, data]) => ({
    path,
    size_bytes: data.length,
    sha256: createHash("sha256").update(data).digest("hex"),
  }));
}

/** Return all files, manifest.json included. */
export function allFiles({ files, manifest }: TinyBundle): Map<string, Bytes> {
  return new Map([["manifest.json", bytes(Buffer.from(JSON.stringify(manifest)))], ...files]);
}

/** Return a bundle's files as a source that can list them. */
export function sourceOf(bundle: TinyBundle): FileSource {
  const files = allFiles(bundle);
  return {
    paths: new Set(files.keys()),
    read: async (path) => {
      const data = files.get(path);
      if (data === undefined) throw new BundleFault("bundle.file_missing", path);
      return data;
    },
  };
}

/** Return a zip archive of some files. */
export function zipOf(files: ReadonlyMap<string, Bytes>, { packed = false, flags = 0 } = {}): Bytes {
  const parts: Buffer[] = [];
  const directory: Buffer[] = [];
  let offset = 0;
  for (const [path, data] of files) {
    const name = Buffer.from(path);
    const body = packed ? deflateRawSync(data) : Buffer.from(data);
    const head = Buffer.alloc(30);
    head.writeUInt32LE(0x04034b50, 0);
    head.writeUInt16LE(name.length, 26);
    const entry = Buffer.alloc(46);
    entry.writeUInt32LE(0x02014b50, 0);
    entry.writeUInt16LE(flags, 8);
    entry.writeUInt16LE(packed ? 8 : 0, 10);
    entry.writeUInt32LE(body.length, 20);
    entry.writeUInt32LE(data.length, 24);
    entry.writeUInt16LE(name.length, 28);
    entry.writeUInt32LE(offset, 42);
    parts.push(head, name, body);
    directory.push(entry, name);
    offset += 30 + name.length + body.length;
  }
  const end = Buffer.alloc(22);
  const length = directory.reduce((sum, part) => sum + part.length, 0);
  end.writeUInt32LE(0x06054b50, 0);
  end.writeUInt16LE(files.size, 10);
  end.writeUInt32LE(length, 12);
  end.writeUInt32LE(offset, 16);
  return bytes(Buffer.concat([...parts, ...directory, end]));
}
