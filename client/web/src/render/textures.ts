/** A bundle's tables as textures. */

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
import { type PackedTransport, type PlaneTable, tableRows, tableWidth } from "../bundle/transport.js";
import { ggxBands, numLobeSteps } from "../engine/lobes.js";
import { tableSide } from "../engine/splitSum.js";
import type { PreparedLight } from "../light/prepare.js";

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

function numbers(data: Uint32Array<ArrayBuffer>, width: number): DataTexture {
  const format = RedIntegerFormat as PixelFormat;
  return ready(new DataTexture(data, width, data.length / width, format, UnsignedIntType), "R32UI");
}

/** Return the longest side of the textures that a transport's tables become; they cannot be made smaller. */
export function longestSide({ size, direct, visibility, indirect, material }: PackedTransport): number {
  const rows = [direct, visibility, indirect, material].map((table) => table.rows);
  return Math.max(tableWidth, size, ...rows);
}

/** Textures of one bundle, independent of the light. */
export class BundleTextures {
  readonly direct: DataArrayTexture;
  readonly visibility: DataArrayTexture;
  readonly indirect: DataArrayTexture;
  readonly material: DataArrayTexture;
  readonly texelPlane: DataTexture;
  readonly coarseOfTexel: DataTexture;
  readonly shadowBits: DataArrayTexture | null = null;
  readonly lobeTable: DataTexture;
  readonly uncertainty: Data3DTexture | null = null;
  /** The mesh's albedo, linear when it is looked up, with smaller versions. */
  readonly albedoMap: Texture | null = null;
  readonly packedMap: Texture | null = null;
  /** The smallest version of the albedo whose charts lie apart. */
  readonly lastLevel: number = 0;

  constructor(
    readonly transport: PackedTransport,
    grid: UncertaintyGrid | null,
    maps: MaterialMaps | null,
    /** Texels along a side of the largest texture that the graphics card takes. */
    largestSide: number,
  ) {
    this.direct = planes(transport.direct);
    this.visibility = planes(transport.visibility);
    this.indirect = planes(transport.indirect);
    this.material = planes(transport.material);
    this.texelPlane = numbers(transport.texelPlane, transport.size);
    this.coarseOfTexel = numbers(transport.coarseOfTexel, tableWidth);
    if (transport.shadowBits !== null) {
      const rows = tableRows(transport.numTexels);
      const bits = new DataArrayTexture(transport.shadowBits, tableWidth, rows, 2);
      bits.format = RGBAIntegerFormat;
      bits.type = UnsignedIntType;
      this.shadowBits = ready(bits, "RGBA32UI");
    }
    this.lobeTable = lobeTexture(transport.visibility.bands);
    if (grid !== null) this.uncertainty = gridTexture(grid);
    if (maps !== null) {
      const albedo = fitted(maps.albedo, largestSide);
      this.albedoMap = pictureTexture(albedo);
      this.albedoMap.colorSpace = SRGBColorSpace;
      this.albedoMap.generateMipmaps = true;
      this.albedoMap.minFilter = LinearMipmapLinearFilter;
      this.packedMap = pictureTexture(fitted(maps.packed, largestSide));
      this.lastLevel = Math.max(0, Math.floor(Math.log2(albedo.width / transport.size)));
    }
  }

  /** All of them. */
  get all(): Texture[] {
    return Object.values(this).filter((each) => each instanceof Texture);
  }

  dispose(): void {
    for (const texture of this.all) texture.dispose();
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
 * are encoded. three.js would make it smaller too, but would not say so, and `lastLevel` belongs to the picture's size.
 */
export function fitted(picture: ImageBitmap, largest: number): ImageBitmap {
  let found = picture;
  while (Math.max(found.width, found.height) > largest) {
    const [width, height] = [Math.ceil(found.width / 2), Math.ceil(found.height / 2)];
    const canvas = new OffscreenCanvas(width, height);
    canvas.getContext("2d")!.drawImage(found, 0, 0, width, height);
    found = canvas.transferToImageBitmap();
  }
  return found;
}

function pictureTexture(picture: ImageBitmap): Texture {
  const texture = new Texture(picture);
  texture.flipY = false;
  texture.generateMipmaps = false;
  texture.minFilter = LinearFilter;
  texture.magFilter = LinearFilter;
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
  return ready(new DataTexture(table, tableSide, tableSide, RGFormat, FloatType), "RG32F");
}

/** Return the levels of a light. */
export function levelsTexture({ levels }: PreparedLight): DataTexture {
  const { halfRgba, width, height } = levels;
  return ready(new DataTexture(halfRgba, width, height, RGBAFormat, HalfFloatType), "RGBA16F");
}
