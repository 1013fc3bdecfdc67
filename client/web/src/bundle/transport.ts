/**
 * Baked light transport, checked as `lambent_relight.baked.transport` does and laid out for textures.
 *
 * Values per covered texel lie in tables `tableWidth` texels wide; texel t is at (t mod tableWidth, t / tableWidth).
 * Planes keep their signed bytes q, four planes to a layer; value = offset + scale q.
 * Source: docs/reference/bundle-format.md (transport).
 */

import { numShadowDirections } from "../contract/constants.js";
import type { Transport, TransportPlanes } from "../contract/lambent_proto/v1/bundle_pb.js";
import { type BundleFault, exportAgain } from "../page/fault.js";
import { maxAtlasSize } from "./manifest.js";
import { blocksAround, spreadTexels } from "./texels.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** Columns of all tables. */
export const tableWidth = 1024;

/** Planes of texels in layers of four. */
export type PlaneTable = {
  readonly bands: number;
  readonly layers: number;
  readonly rows: number;
  /** [layer, texel, 4], zero where there is none. */
  readonly steps: Int8Array<ArrayBuffer>;
  /** One per plane, zero for the planes that fill up the last layer. */
  readonly scales: Float32Array<ArrayBuffer>;
  readonly offsets: Float32Array<ArrayBuffer>;
};

/** The transport of a bundle. */
export type PackedTransport = {
  /** Texels along a side of the square atlas. */
  readonly size: number;
  readonly numTexels: number;
  /** Number of the nearest covered texel at every place of the atlas, rows from the top. */
  readonly texelPlane: Uint32Array<ArrayBuffer>;
  readonly direct: PlaneTable;
  readonly visibility: PlaneTable;
  /** Plane 3 k + c is coefficient k of channel c, over coarse texels. */
  readonly indirect: PlaneTable;
  /** Number of the coarse texel of every texel, as a table. */
  readonly coarseOfTexel: Uint32Array<ArrayBuffer>;
  /** The four coarse texels around every texel; see `blocksAround`. */
  readonly blocksAround: Uint32Array<ArrayBuffer>;
};

/** A transport with what only light from the surface itself needs. */
export type HitTransport = PackedTransport & {
  /** Albedo (3), perceptual roughness, metalness, world normal (3). */
  readonly material: PlaneTable;
  /** 256 bits per texel in two layers of four words, lowest bit first; null where the bundle has none. */
  readonly shadowBits: Uint32Array<ArrayBuffer> | null;
};

type Reader = (path: string) => Promise<Uint8Array<ArrayBuffer>>;
/** Returns a file, or only its first bytes where these are enough for now. */
type HeadReader = (path: string, bytes: number) => Promise<Uint8Array<ArrayBuffer>>;

// Channels, the largest number of bands, and how many of them make a first picture: those of a lite bundle.
const sets = {
  direct: [1, 9, 5],
  visibility: [1, 9, 3],
  indirect: [3, 9, 9],
  material: [8, 1, 1],
} as const;

/** The bytes of tables whose planes were not all there. */
export type FinerTables = { readonly [name in "direct" | "visibility"]: Int8Array<ArrayBuffer> };

function invalid(what: string): BundleFault {
  return exportAgain("bundle.transport_invalid", fillIn(bundleFaults.transport, { what }));
}

/** Return the number of rows of a table of `count` texels. */
export function tableRows(count: number): number {
  return Math.max(1, Math.ceil(count / tableWidth));
}

/** Return all steps of the tables of which the first planes were read; `read` returns all of a file. */
export async function finerTables(stated: Transport, read: Reader): Promise<FinerTables> {
  const load = async (name: keyof FinerTables) => {
    const planes = stated.planes.find((each) => each.name === name)!;
    return packPlanes(planes, await read(planes.path), stated.numTexels, Infinity).steps;
  };
  const [direct, visibility] = await Promise.all([load("direct"), load("visibility")]);
  return { direct, visibility };
}

/**
 * Read and check the transport that a manifest states, but for what `forHits` reads, which no picture needs at first.
 * Where `read` returns only the first planes of a table, the others are about zero.
 */
export async function readTransport(stated: Transport, read: HeadReader): Promise<PackedTransport> {
  const { size } = stated;
  if (!(size >= 1 && size <= maxAtlasSize)) throw invalid(fillIn(bundleFaults.atlasSize, { size }));
  const texelIndex = coveredTexels(await read(stated.texelsPath, Infinity), size);
  const numTexels = texelIndex.length;
  if (numTexels !== stated.numTexels || numTexels === 0) {
    throw invalid(fillIn(bundleFaults.covers, { found: numTexels, stated: stated.numTexels }));
  }
  const { numCoarse, coarseOfTexel } = coarseTexels(texelIndex, size);
  const load = async (name: "direct" | "visibility" | "indirect"): Promise<PlaneTable> => {
    const planes = statedPlanes(stated, name);
    const [channels, , first] = sets[name];
    const texels = name === "indirect" ? numCoarse : numTexels;
    const head = planes.bands > first ? first ** 2 * channels * texels : Infinity;
    return packPlanes(planes, await read(planes.path, head), texels, head);
  };
  // Those that are read in part come after the others.
  const [indirect, visibility, direct] = await Promise.all([
    load("indirect"),
    load("visibility"),
    load("direct"),
  ]);
  if (indirect.bands > direct.bands) throw invalid(bundleFaults.moreIndirect);
  if (stated.shadowBitsPath !== "" && stated.numShadowDirections !== numShadowDirections) {
    throw invalid(fillIn(bundleFaults.shadowDirections, { number: stated.numShadowDirections }));
  }
  const texelPlane = spreadTexels(texelIndex, size);
  return {
    size,
    numTexels,
    texelPlane,
    blocksAround: blocksAround(texelIndex, texelPlane, coarseOfTexel, size),
    direct,
    visibility,
    indirect,
    coarseOfTexel,
  };
}

/** Return a transport with its materials and its shadow bits; without bits where the manifest states none. */
export async function forHits(
  transport: PackedTransport,
  stated: Transport,
  read: Reader,
): Promise<HitTransport> {
  const { numTexels } = transport;
  const readMaterial = async (): Promise<PlaneTable> => {
    const planes = statedPlanes(stated, "material");
    return packPlanes(planes, await read(planes.path), numTexels, Infinity);
  };
  const readBits = async () =>
    stated.shadowBitsPath === "" ? null : packShadowBits(await read(stated.shadowBitsPath), numTexels);
  const [material, shadowBits] = await Promise.all([readMaterial(), readBits()]);
  return { ...transport, material, shadowBits };
}

/** Return what a manifest states of planes, checked. */
function statedPlanes(stated: Transport, name: keyof typeof sets): TransportPlanes {
  const planes = stated.planes.find((each) => each.name === name);
  if (planes === undefined) throw invalid(fillIn(bundleFaults.noPlanes, { name }));
  const [channels, most] = sets[name];
  if (planes.channels !== channels || !(planes.bands >= 1 && planes.bands <= most)) {
    throw invalid(fillIn(bundleFaults.planes, { name, bands: planes.bands, channels: planes.channels }));
  }
  return planes;
}

/** Return the places of covered texels, rising, from one bit per place, lowest first. */
function coveredTexels(mask: Uint8Array, size: number): Uint32Array {
  if (mask.length !== Math.ceil((size * size) / 8)) {
    throw invalid(fillIn(bundleFaults.maskBytes, { bytes: mask.length, size }));
  }
  const found = new Uint32Array(size * size);
  let count = 0;
  for (let place = 0; place < size * size; place++) {
    if ((mask[place >> 3]! >> (place & 7)) & 1) found[count++] = place;
  }
  return found.slice(0, count);
}

/** Number the 2 x 2 blocks with a covered texel in the order of their place. */
function coarseTexels(
  texelIndex: Uint32Array,
  size: number,
): { numCoarse: number; coarseOfTexel: Uint32Array<ArrayBuffer> } {
  const half = Math.ceil(size / 2);
  const blockOf = (place: number): number => (Math.floor(place / size) >> 1) * half + ((place % size) >> 1);
  const rank = new Int32Array(half * half).fill(-1);
  for (const place of texelIndex) rank[blockOf(place)] = 0;
  let numCoarse = 0;
  rank.forEach((seen, block) => {
    if (seen === 0) rank[block] = numCoarse++;
  });
  const coarseOfTexel = new Uint32Array(tableWidth * tableRows(texelIndex.length));
  texelIndex.forEach((place, texel) => {
    coarseOfTexel[texel] = rank[blockOf(place)]!;
  });
  return { numCoarse, coarseOfTexel };
}

function packPlanes(
  stated: TransportPlanes,
  data: Uint8Array<ArrayBuffer>,
  numTexels: number,
  head: number,
): PlaneTable {
  const count = stated.bands ** 2 * stated.channels;
  const isThere = data.length === count * numTexels || data.length === head;
  if (stated.scales.length !== count || stated.offsets.length !== count || !isThere) {
    throw invalid(
      fillIn(bundleFaults.planeBytes, {
        path: stated.path.slice(0, 200),
        bytes: data.length,
        scales: stated.scales.length,
        planes: count,
        texels: numTexels,
      }),
    );
  }
  if (![...stated.scales, ...stated.offsets].every(Number.isFinite)) {
    throw invalid(fillIn(bundleFaults.scaleNotFinite, { path: stated.path.slice(0, 200) }));
  }
  const layers = Math.ceil(count / 4);
  const rows = tableRows(numTexels);
  const steps = new Int8Array(4 * layers * rows * tableWidth);
  fillSteps(steps, data, stated, numTexels, rows);
  const scales = new Float32Array(4 * layers);
  const offsets = new Float32Array(4 * layers);
  scales.set(stated.scales);
  offsets.set(stated.offsets);
  return { bands: stated.bands, layers, rows, steps, scales, offsets };
}

/** Write planes into a table; those that are not there become about zero. */
function fillSteps(
  steps: Int8Array,
  data: Uint8Array<ArrayBuffer>,
  { bands, channels, scales, offsets }: TransportPlanes,
  numTexels: number,
  rows: number,
): void {
  const bytes = new Int8Array(data.buffer, data.byteOffset, data.length);
  for (let plane = 0; plane < bands ** 2 * channels; plane++) {
    let target = 4 * (plane >> 2) * rows * tableWidth + (plane & 3);
    const start = plane * numTexels;
    const isThere = start < bytes.length;
    const zero = Math.min(Math.max(Math.round(-offsets[plane]! / (scales[plane]! || 1)), -127), 127);
    for (let texel = 0; texel < numTexels; texel++, target += 4) {
      steps[target] = isThere ? bytes[start + texel]! : zero;
    }
  }
}

function packShadowBits(data: Uint8Array<ArrayBuffer>, numTexels: number): Uint32Array<ArrayBuffer> {
  if (data.length !== (numTexels * numShadowDirections) / 8)
    throw invalid(fillIn(bundleFaults.shadowBytes, { bytes: data.length }));
  const words = new Uint32Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.length));
  const layer = 4 * tableWidth * tableRows(numTexels);
  const packed = new Uint32Array(2 * layer);
  for (let texel = 0; texel < numTexels; texel++) {
    packed.set(words.subarray(8 * texel, 8 * texel + 4), 4 * texel);
    packed.set(words.subarray(8 * texel + 4, 8 * texel + 8), layer + 4 * texel);
  }
  return packed;
}
