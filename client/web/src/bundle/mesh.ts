/** The surface of a bundle, read from its mesh/asset.glb, as `lambent_relight.baked.mesh` does. */

import { type BundleFault, exportAgain } from "../page/fault.js";
import { maxAtlasSize } from "./manifest.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** Triangles with a place in the atlas; positions are the world's, z up. */
export type AtlasMesh = {
  readonly positionsXyz: Float32Array<ArrayBuffer>;
  /** Pairs in [0, 1], v down from the top row of the atlas. */
  readonly uv: Float32Array<ArrayBuffer>;
  readonly indices: Uint32Array<ArrayBuffer>;
  readonly normalsXyz: Float32Array<ArrayBuffer>;
  /** Frames of the normal map, as in glTF. */
  readonly tangentsXyzw: Float32Array<ArrayBuffer>;
};

type Numbers = Uint8Array | Uint16Array | Uint32Array | Float32Array;
type Json = { readonly [key: string]: unknown };

/** The signature of a PNG file, and length and name of its first chunk. */
const pngStart = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0, 0, 0, 13, 0x49, 0x48, 0x44, 0x52];
const components: Readonly<Record<string, number>> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
const itemBytes: Readonly<Record<number, 1 | 2 | 4>> = { 5121: 1, 5123: 2, 5125: 4, 5126: 4 };

function invalid(what: string): BundleFault {
  return exportAgain("bundle.mesh_invalid", fillIn(bundleFaults.mesh, { what }));
}

/** Return the first primitive of a binary glTF file; throws BundleFault for one that cannot be used. */
export function meshFromGlb(data: Uint8Array<ArrayBuffer>): AtlasMesh {
  const { document, payload } = chunks(data);
  const primitive = object(list(object(list(document.meshes)[0]).primitives)[0]);
  const attributes = object(primitive.attributes);
  const positions = accessor(document, payload, attributes.POSITION, "VEC3");
  const places = accessor(document, payload, attributes.TEXCOORD_0, "VEC2");
  const found = accessor(document, payload, primitive.indices, "SCALAR");
  if ((primitive.mode ?? 4) !== 4 || found.length % 3 !== 0 || found instanceof Float32Array) {
    throw invalid(bundleFaults.notTriangles);
  }
  const numVertices = positions.length / 3;
  if (!(positions instanceof Float32Array) || places.length !== 2 * numVertices) {
    throw invalid(bundleFaults.coordinateCount);
  }
  const largest = places instanceof Float32Array ? 1 : 2 ** (8 * places.BYTES_PER_ELEMENT) - 1;
  const uv = Float32Array.from(places, (value) => value / largest);
  if (!positions.every(Number.isFinite) || !uv.every((value) => value >= 0 && value <= 1)) {
    throw invalid(bundleFaults.coordinateRange);
  }
  const indices = Uint32Array.from(found);
  if (numVertices === 0 || indices.length === 0 || !indices.every((index) => index < numVertices)) {
    throw invalid(bundleFaults.noSuchVertex);
  }
  const shading = (slot: unknown, kind: string): Float32Array<ArrayBuffer> => {
    const values = accessor(document, payload, slot, kind);
    const fits = values instanceof Float32Array && values.length === components[kind]! * numVertices;
    if (!fits || !values.every(Number.isFinite)) throw invalid(bundleFaults.shadingCount);
    return new Float32Array(values);
  };
  return {
    positionsXyz: new Float32Array(positions),
    uv,
    indices,
    normalsXyz: shading(attributes.NORMAL, "VEC3"),
    tangentsXyzw: shading(attributes.TANGENT, "VEC4"),
  };
}

/** A PNG file and the size that its header states. */
export type PngFile = {
  readonly data: Uint8Array<ArrayBuffer>;
  readonly width: number;
  readonly height: number;
};

/** The PNG files of the mesh's textures. */
export type TextureFiles = {
  /** sRGB-encoded albedo. */
  readonly baseColour: PngFile;
  /** Occlusion, perceptual roughness and metalness. */
  readonly packed: PngFile;
  /** Normals in the frames of the tangents, -1..1 as 0..255. */
  readonly normal: PngFile;
};

/**
 * Return the textures of a binary glTF file, not decoded.
 *
 * Throws BundleFault where they are not there, or state more than `maxAtlasSize` texels a side: a file of some bytes
 * can stand for a picture of gigabytes.
 */
export function texturesFromGlb(data: Uint8Array<ArrayBuffer>): TextureFiles {
  const { document, payload } = chunks(data);
  const material = object(list(document.materials)[0]);
  const surface = object(material.pbrMetallicRoughness);
  const picture = (slot: unknown): PngFile => {
    const texture = object(list(document.textures)[whole(object(slot).index)]);
    const image = object(list(document.images)[whole(texture.source)]);
    const view = object(list(document.bufferViews)[whole(image.bufferView)]);
    const start = whole(view.byteOffset ?? 0);
    const end = start + whole(view.byteLength);
    if (end > payload.length) throw invalid(bundleFaults.textureLeaves);
    return sizedPng(payload.slice(start, end));
  };
  return {
    baseColour: picture(surface.baseColorTexture),
    packed: picture(surface.metallicRoughnessTexture),
    normal: picture(material.normalTexture),
  };
}

/** Return a PNG file with the size of its header (PNG specification, 11.2.2: IHDR is the first chunk). */
function sizedPng(data: Uint8Array<ArrayBuffer>): PngFile {
  if (data.length < 33 || pngStart.some((byte, index) => data[index] !== byte))
    throw invalid(bundleFaults.textureNotPng);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const [width, height] = [view.getUint32(16), view.getUint32(20)];
  if (Math.max(width, height) > maxAtlasSize)
    throw invalid(fillIn(bundleFaults.textureTooLarge, { width, height, most: maxAtlasSize }));
  return { data, width, height };
}

/** Return the box around points. */
export function boundsOf(positionsXyz: Float32Array): { boundsMin: number[]; boundsMax: number[] } {
  const boundsMin = [Infinity, Infinity, Infinity];
  const boundsMax = [-Infinity, -Infinity, -Infinity];
  positionsXyz.forEach((value, index) => {
    boundsMin[index % 3] = Math.min(boundsMin[index % 3]!, value);
    boundsMax[index % 3] = Math.max(boundsMax[index % 3]!, value);
  });
  return { boundsMin, boundsMax };
}

function object(value: unknown): Json {
  if (typeof value !== "object" || value === null || Array.isArray(value))
    throw invalid(bundleFaults.notGltf);
  return value as Json;
}

function list(value: unknown): readonly unknown[] {
  if (!Array.isArray(value)) throw invalid(bundleFaults.notGltf);
  return value;
}

function whole(value: unknown): number {
  if (typeof value !== "number" || !Number.isSafeInteger(value) || value < 0)
    throw invalid(bundleFaults.badCount);
  return value;
}

function chunks(data: Uint8Array<ArrayBuffer>): { document: Json; payload: Uint8Array<ArrayBuffer> } {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  if (data.length < 28 || view.getUint32(0, true) !== 0x46546c67 || view.getUint32(4, true) !== 2) {
    throw invalid(bundleFaults.notGlb);
  }
  const length = view.getUint32(12, true);
  const start = 20 + length;
  if (view.getUint32(16, true) !== 0x4e4f534a || start + 8 > data.length) throw invalid(bundleFaults.noJson);
  const end = start + 8 + view.getUint32(start, true);
  if (view.getUint32(start + 4, true) !== 0x004e4942 || end > data.length)
    throw invalid(bundleFaults.noBinary);
  try {
    const document = object(JSON.parse(new TextDecoder().decode(data.subarray(20, start))));
    return { document, payload: data.slice(start + 8, end) };
  } catch {
    throw invalid(bundleFaults.notGltf);
  }
}

function accessor(document: Json, payload: Uint8Array<ArrayBuffer>, index: unknown, kind: string): Numbers {
  const stated = object(list(document.accessors)[whole(index)]);
  const view = object(list(document.bufferViews)[whole(stated.bufferView)]);
  const type = whole(stated.componentType);
  const size = itemBytes[type];
  const width = components[kind]!;
  if (stated.type !== kind || "sparse" in stated || (view.buffer ?? 0) !== 0 || size === undefined) {
    throw invalid(bundleFaults.accessorForm);
  }
  const count = whole(stated.count);
  const stride = whole(view.byteStride ?? size * width);
  const start = whole(view.byteOffset ?? 0) + whole(stated.byteOffset ?? 0);
  if (stride < size * width || (count > 0 && start + (count - 1) * stride + size * width > payload.length)) {
    throw invalid(bundleFaults.accessorLeaves);
  }
  const packed = new Uint8Array(count * size * width);
  for (let row = 0; row < count; row++) {
    packed.set(
      payload.subarray(start + row * stride, start + row * stride + size * width),
      row * size * width,
    );
  }
  if (type === 5126) return new Float32Array(packed.buffer);
  if (size === 1) return packed;
  return size === 2 ? new Uint16Array(packed.buffer) : new Uint32Array(packed.buffer);
}
