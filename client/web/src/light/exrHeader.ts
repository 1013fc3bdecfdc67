/**
 * Reads and checks the header of an OpenEXR file, like `lambent_core.exr`. three's loader cannot do that: it
 * returns a header only with the decoded picture, and believes the sizes that the header states.
 */

import type { Matrix3 } from "three";
import type { EnvironmentMap } from "../engine/environmentMap.js";
import { MapFault, tooLarge } from "../page/fault.js";
import { fillIn, mapFaults } from "../words/words.js";
import type { Layout } from "./layouts.js";
import { rec709Matrix, toRec709 } from "./primaries.js";

/** What is stored, and what is to be done to it. */
export type Shown = {
  readonly stored: { readonly width: number; readonly height: number; readonly firstLine: number };
  /** Where the display window begins in the stored picture, and its size. */
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
  /** From the stated primaries to Rec. 709. */
  readonly matrix: Matrix3 | null;
};

/** The attributes of the first part with red, green and blue, or else of the first: where the value of each lies. */
export type Stated = {
  readonly part: number;
  /** Bits of the second to fourth byte of the version: tiles 2, deep 8, several parts 16. */
  readonly flags: number;
  readonly attributes: ReadonlyMap<string, DataView>;
  /** Offset of the end of the header. */
  readonly end: number;
};

const deep = 8;

/** Return the fault of a file that is not a complete OpenEXR picture. */
export function damaged(): MapFault {
  return new MapFault("environment.exr_damaged", mapFaults.exrDamaged);
}

/**
 * Return what a file states. Throws for a size above the limit, or a header that leaves the file, before anything is
 * decoded: decoders trust the sizes that a header states.
 */
export function statedBy(data: Uint8Array<ArrayBuffer>, maxPixels: number): Stated {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  let place = 8;
  const text = (): string => {
    const end = data.indexOf(0, place);
    if (end < 0 || end > place + 255) throw damaged();
    const found = new TextDecoder("latin1").decode(data.subarray(place, end));
    place = end + 1;
    return found;
  };
  if (data.length < 24 || view.getUint32(0, true) !== 20000630) throw damaged();
  const flags = view.getUint8(5);
  const severalParts = (flags & 16) !== 0;
  const parts: Map<string, DataView>[] = [];
  for (let more = true; more; ) {
    const attributes = new Map<string, DataView>();
    parts.push(attributes);
    for (let name = text(); name !== ""; name = text()) {
      const type = text();
      if (place + 4 > data.length) throw damaged();
      const size = view.getInt32(place, true);
      place += 4;
      if (size < 0 || place + size > data.length) throw damaged();
      const value = new DataView(data.buffer, data.byteOffset + place, size);
      if (name === "dataWindow") {
        const { width, height } = boxOf(type === "box2i" ? value : undefined);
        if (width <= 0 || height <= 0) throw damaged();
        if (width * height > maxPixels) throw tooLarge(width, height, maxPixels);
      }
      attributes.set(name, value);
      place += size;
    }
    more = severalParts && data[place] !== 0;
  }
  const part = Math.max(parts.findIndex(hasColour), 0);
  return { flags, part, attributes: parts[part]!, end: place };
}

function hasColour(attributes: ReadonlyMap<string, DataView>): boolean {
  const names = channelsOf(attributes.get("channels")).map(({ name }) => name);
  return ["R", "G", "B"].every((name) => names.includes(name));
}

function boxOf(view: DataView | undefined): { left: number; top: number; width: number; height: number } {
  if (view?.byteLength !== 16) throw damaged();
  const [left, top] = [view.getInt32(0, true), view.getInt32(4, true)];
  return {
    left,
    top,
    width: view.getInt32(8, true) - left + 1,
    height: view.getInt32(12, true) - top + 1,
  };
}

/** A channel in a header; `type` 1 is half. */
export type Channel = {
  readonly name: string;
  readonly type: number;
  readonly xSampling: number;
  readonly ySampling: number;
};

/** Return the channels of a list; throws for a damaged one. */
export function channelsOf(view: DataView | undefined): Channel[] {
  const channels: Channel[] = [];
  if (view === undefined) return channels;
  const bytes = new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
  for (let place = 0; place < bytes.length && bytes[place] !== 0; ) {
    const end = bytes.indexOf(0, place);
    if (end < 0 || end + 17 > bytes.length) throw damaged();
    const name = new TextDecoder("latin1").decode(bytes.subarray(place, end));
    const [xSampling, ySampling] = [view.getInt32(end + 9, true), view.getInt32(end + 13, true)];
    channels.push({ name, type: view.getInt32(end + 1, true), xSampling, ySampling });
    place = end + 17;
  }
  return channels;
}

/** Return the layout that the attribute envmap states, if it is there. */
export function statedLayout({ attributes }: Stated): Layout | undefined {
  const value = attributes.get("envmap");
  return value?.byteLength === 1 ? (["latlong", "cube"] as const)[value.getUint8(0)] : undefined;
}

/** Return what to do to the pixels; throws for a picture without whole red, green and blue at full resolution. */
export function checkHeader({ attributes, flags }: Stated): Shown {
  if (flags & deep) throw new MapFault("environment.exr_deep", mapFaults.exrDeep);
  const channels = channelsOf(attributes.get("channels"));
  if (!hasColour(attributes)) {
    const names = channels.map(({ name }) => name).sort();
    const shown = names.slice(0, 16).join(", ");
    throw new MapFault("environment.exr_channels", fillIn(mapFaults.exrChannels, { channels: shown }));
  }
  const colours = channels.filter(({ name }) => ["R", "G", "B"].includes(name));
  if (colours.some(({ xSampling, ySampling }) => xSampling !== 1 || ySampling !== 1)) {
    throw new MapFault("environment.exr_channels", mapFaults.exrSubsampled);
  }
  const stored = boxOf(attributes.get("dataWindow"));
  const { width, height, ...window } = boxOf(attributes.get("displayWindow"));
  const [left, top] = [window.left - stored.left, window.top - stored.top];
  const inside = left >= 0 && top >= 0 && left + width <= stored.width && top + height <= stored.height;
  if (!inside || width <= 0 || height <= 0) {
    throw new MapFault("environment.exr_cropped", mapFaults.exrCropped);
  }
  const stated = attributes.get("chromaticities");
  const matrix =
    stated === undefined
      ? null
      : rec709Matrix(
          Array.from({ length: stated.byteLength / 4 }, (_, at) => stated.getFloat32(4 * at, true)),
        );
  if (matrix === undefined) throw new MapFault("environment.exr_primaries", mapFaults.exrPrimaries);
  return {
    stored: { width: stored.width, height: stored.height, firstLine: stored.top },
    left,
    top,
    width,
    height,
    matrix,
  };
}

/** Return the display window of the stored picture, in Rec. 709. */
export function shownOf(storedRgb: Float32Array, shown: Shown): EnvironmentMap {
  const { stored, left, top, width, height, matrix } = shown;
  let radianceRgb = storedRgb;
  if (width !== stored.width || height !== stored.height) {
    radianceRgb = new Float32Array(3 * width * height);
    for (let row = 0; row < height; row++) {
      const from = 3 * ((top + row) * stored.width + left);
      radianceRgb.set(storedRgb.subarray(from, from + 3 * width), 3 * row * width);
    }
  }
  toRec709(radianceRgb, matrix);
  return { height, width, radianceRgb };
}
