/** A bundle's tables as textures. */

import { numLobeSteps, splitSumSide } from "../contract/constants.js";
import {
  ByteType,
  Data3DTexture,
  DataArrayTexture,
  DataTexture,
  FloatType,
  HalfFloatType,
  LinearFilter,
  LinearMipmapLinearFilter,
  type PixelFormat,
  RedFormat,
  RedIntegerFormat,
  RGBAFormat,
  RGBAIntegerFormat,
  RGFormat,
  SRGBColorSpace,
  Texture,
  UnsignedIntType,
} from "three";
import type { MaterialMaps } from "../bundle/load.js";
import type { UncertaintyGrid } from "../bundle/uncertainty.js";
import { type FinerTables, type PackedTransport, type PlaneTable, tableWidth } from "../bundle/transport.js";
import { ggxBands } from "../engine/lobes.js";
import type { PreparedLight } from "../light/prepare.js";

/** Most looks along the longer side of a pixel's footprint. */
const anisotropy = 4;

function ready<T extends Texture>(texture: T, internal: T["internalFormat"]): T {
  texture.internalFormat = internal;
  texture.needsUpdate = true;
  return texture;
}

function planes(table: PlaneTable): DataArrayTexture {
  const texture = new DataArrayTexture(table.steps, tableWidth, table.rows, table.layers);
  texture.format = RGBAIntegerFormat;
  texture.type = ByteType;
  return ready(texture, "RGBA8I");
}

function numbers(data: Uint32Array<ArrayBuffer>, width: number, channels: 1 | 4 = 1): DataTexture {
  const format = (channels === 1 ? RedIntegerFormat : RGBAIntegerFormat) as PixelFormat;
  const rows = data.length / (channels * width);
  return ready(
    new DataTexture(data, width, rows, format, UnsignedIntType),
    channels === 1 ? "R32UI" : "RGBA32UI",
  );
}

/**
 * Planes laid out as the atlas, its gutters filled with the nearest covered texel, for filtering by the hardware: a
 * value is offset + 127 scale times what is looked up.
 */
function atlasPlanes(table: PlaneTable, transport: PackedTransport): DataArrayTexture {
  const { size } = transport;
  const texture = new DataArrayTexture(atlasSteps(table, transport), size, size, table.layers);
  texture.format = RGBAFormat;
  texture.type = ByteType;
  texture.minFilter = LinearFilter;
  texture.magFilter = LinearFilter;
  return ready(texture, "RGBA8_SNORM");
}

function atlasSteps(table: PlaneTable, { texelPlane, size }: PackedTransport): Int8Array<ArrayBuffer> {
  const places = size * size;
  const data = new Int8Array(4 * places * table.layers);
  const from = new Int32Array(table.steps.buffer);
  const to = new Int32Array(data.buffer);
  for (let layer = 0; layer < table.layers; layer++) {
    const [start, first] = [layer * table.rows * tableWidth, layer * places];
    for (let place = 0; place < places; place++) to[first + place] = from[start + texelPlane[place]!]!;
  }
  return data;
}

/** Return scales for what the hardware makes of signed bytes, -1 to 1. */
export function normalisedScales({ scales }: PlaneTable): Float32Array<ArrayBuffer> {
  return scales.map((value) => 127 * value);
}

/** Return the longest side of the textures that a transport's tables become; they cannot be made smaller. */
export function longestSide({ size, direct, visibility, indirect }: PackedTransport): number {
  const rows = [direct, visibility, indirect].map((table) => table.rows);
  return Math.max(tableWidth, size, ...rows);
}

/** Textures of one bundle, independent of the light. */
export class BundleTextures {
  readonly direct: DataArrayTexture;
  /** As the atlas, filtered. */
  readonly visibility: DataArrayTexture;
  readonly indirect: DataArrayTexture;
  readonly texelPlane: DataTexture;
  readonly blocksAround: DataTexture;
  readonly lobeTable: DataTexture;
  readonly uncertainty: Data3DTexture | null = null;
  /** The mesh's albedo, linear when it is looked up; as the next two with smaller versions. */
  readonly albedoMap: Texture;
  readonly packedMap: Texture;
  readonly normalMap: Texture;

  constructor(
    readonly transport: PackedTransport,
    grid: UncertaintyGrid | null,
    maps: MaterialMaps,
    /** Texels along a side of the largest texture that the graphics card takes. */
    largestSide: number,
  ) {
    this.direct = planes(transport.direct);
    this.visibility = atlasPlanes(transport.visibility, transport);
    this.indirect = planes(transport.indirect);
    this.texelPlane = numbers(transport.texelPlane, transport.size);
    this.blocksAround = numbers(transport.blocksAround, tableWidth, 4);
    this.lobeTable = lobeTexture(transport.visibility.bands);
    if (grid !== null) this.uncertainty = gridTexture(grid);
    this.albedoMap = pictureTexture(fitted(maps.albedo, largestSide));
    this.albedoMap.colorSpace = SRGBColorSpace;
    this.packedMap = pictureTexture(fitted(maps.packed, largestSide));
    this.normalMap = pictureTexture(fitted(maps.normal, largestSide));
  }

  /** Take all planes in where they were not all there; returns whether anything has changed. */
  async fill(finer: Promise<FinerTables> | null): Promise<boolean> {
    if (finer === null) return false;
    const { direct, visibility } = await finer;
    this.transport.direct.steps.set(direct);
    this.transport.visibility.steps.set(visibility);
    this.direct.needsUpdate = true;
    (this.visibility.image.data as Int8Array).set(atlasSteps(this.transport.visibility, this.transport));
    this.visibility.needsUpdate = true;
    return true;
  }

  get all(): Texture[] {
    return Object.values(this).filter((each) => each instanceof Texture);
  }

  dispose(): void {
    for (const texture of this.all) texture.dispose();
    // Not before: a card that comes back after it was taken away gets them again.
    for (const map of [this.albedoMap, this.packedMap, this.normalMap]) {
      (map.image as ImageBitmap).close();
    }
  }
}

function lobeTexture(bands: number): DataTexture {
  const table = ggxBands(bands);
  const rows = Math.ceil(bands / 4);
  const data = new Float32Array(4 * rows * numLobeSteps);
  table.forEach((value, index) => {
    const [step, band] = [Math.floor(index / bands), index % bands];
    data[4 * ((band >> 2) * numLobeSteps + step) + (band & 3)] = value;
  });
  return ready(new DataTexture(data, numLobeSteps, rows, RGBAFormat, FloatType), "RGBA32F");
}

/**
 * Return a picture halved until no side has more than `largest` pixels: means over 2 x 2 pixels of its levels as they
 * are encoded; the picture itself is closed then. three.js would make it smaller too, but would not say so, and the smallest version that may be looked up belongs to the
 * picture's size.
 */
export function fitted(picture: ImageBitmap, largest: number): ImageBitmap {
  let found = picture;
  while (Math.max(found.width, found.height) > largest) {
    const [width, height] = [Math.ceil(found.width / 2), Math.ceil(found.height / 2)];
    const canvas = new OffscreenCanvas(width, height);
    canvas.getContext("2d")!.drawImage(found, 0, 0, width, height);
    found.close();
    found = canvas.transferToImageBitmap();
  }
  return found;
}

function pictureTexture(picture: ImageBitmap): Texture {
  const texture = new Texture(picture);
  texture.flipY = false;
  texture.generateMipmaps = true;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.magFilter = LinearFilter;
  texture.anisotropy = anisotropy;
  texture.needsUpdate = true;
  return texture;
}

function gridTexture(grid: UncertaintyGrid): Data3DTexture {
  const texture = new Data3DTexture(grid.albedoHalf, ...grid.counts);
  texture.format = RedFormat;
  texture.type = HalfFloatType;
  texture.minFilter = LinearFilter;
  texture.magFilter = LinearFilter;
  return ready(texture, "R16F");
}

/** Return the split-sum table: roughness across, the cosine's root down. */
export function splitSumTexture(table: Float32Array<ArrayBuffer>): DataTexture {
  return ready(new DataTexture(table, splitSumSide, splitSumSide, RGFormat, FloatType), "RG32F");
}

export function levelsTexture({ levels }: PreparedLight): DataTexture {
  const { halfRgba, width, height } = levels;
  return ready(new DataTexture(halfRgba, width, height, RGBAFormat, HalfFloatType), "RGBA16F");
}
