/** Reads and checks the header of an OpenEXR file, like `lambent_core.exr`. */

import type { EnvironmentMap } from "../engine/environmentMap.js";
import { MapFault, tooLarge } from "../page/fault.js";
import type { Layout } from "./layouts.js";
import { type Matrix, rec709Matrix, toRec709 } from "./primaries.js";
import { fillIn, mapFaults } from "../words/words.js";

/** The numbers of the chromaticities of a header, in the order of its bytes. */
export const primaries = ["redX", "redY", "greenX", "greenY", "blueX", "blueY", "whiteX", "whiteY"];

type Box = { readonly xMin: number; readonly yMin: number; readonly xMax: number; readonly yMax: number };
/** The parts of a header that decide whether a map can be used. */
export type Header = {
  readonly dataWindow: Box;
  readonly displayWindow?: Box;
  readonly channels?: readonly { readonly name: string }[];
  readonly chromaticities?: Readonly<Record<string, number>>;
  readonly spec: { readonly deepFormat: boolean };
};

/** What is to be done to the stored pixels. */
export type Shown = {
  /** Where the display window begins in them, and its size. */
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
  /** From the stated primaries to Rec. 709. */
  readonly matrix: Matrix | null;
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

/** Return the fault of a file that is no whole OpenEXR picture. */
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
  let known = false;
  for (let more = true; more; ) {
    const attributes = new Map<string, DataView>();
    parts.push(attributes);
    for (let name = text(); name !== ""; name = text()) {
      const type = text();
      if (place + 4 > data.length) throw damaged();
      const size = view.getInt32(place, true);
      place += 4;
      if (size < 0 || place + size > data.length) throw damaged();
      if (name === "dataWindow" && type === "box2i" && size === 16) {
        known = true;
        const [x0, y0, x1, y1] = [0, 4, 8, 12].map((at) => view.getInt32(place + at, true));
        const [width, height] = [x1! - x0! + 1, y1! - y0! + 1];
        if (width <= 0 || height <= 0) throw damaged();
        if (width * height > maxPixels) throw tooLarge(width, height, maxPixels);
      }
      attributes.set(name, new DataView(data.buffer, data.byteOffset + place, size));
      place += size;
    }
    more = severalParts && data[place] !== 0;
  }
  if (!known) throw damaged();
  const part = Math.max(parts.findIndex(hasColour), 0);
  return { flags, part, attributes: parts[part]!, end: place };
}

function hasColour(attributes: ReadonlyMap<string, DataView>): boolean {
  const names = channelsOf(attributes.get("channels"))?.map(({ name }) => name) ?? [];
  return ["R", "G", "B"].every((name) => names.includes(name));
}

/** A channel in a header; `type` 1 is half. */
export type Channel = {
  readonly name: string;
  readonly type: number;
  readonly xSampling: number;
  readonly ySampling: number;
};

/** Return the channels of a list, or null if it is damaged. */
export function channelsOf(view: DataView | undefined): Channel[] | null {
  const channels: Channel[] = [];
  if (view === undefined) return null;
  const bytes = new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
  for (let place = 0; place < bytes.length && bytes[place] !== 0; ) {
    const end = bytes.indexOf(0, place);
    if (end < 0 || end + 17 > bytes.length) return null;
    const name = new TextDecoder("latin1").decode(bytes.subarray(place, end));
    const [xSampling, ySampling] = [view.getInt32(end + 9, true), view.getInt32(end + 13, true)];
    channels.push({ name, type: view.getInt32(end + 1, true), xSampling, ySampling });
    place = end + 17;
  }
  return channels;
}

/** Throw for a flat picture without red, green and blue at full resolution, on which decoders differ. */
export function checkChannels({ attributes, flags }: Stated): void {
  const channels = channelsOf(attributes.get("channels"));
  if (channels === null || flags & deep) return;
  if (!hasColour(attributes)) throw withoutColour(channels.map(({ name }) => name));
  const colours = channels.filter(({ name }) => ["R", "G", "B"].includes(name));
  if (colours.some(({ xSampling, ySampling }) => xSampling !== 1 || ySampling !== 1)) {
    throw new MapFault("environment.exr_channels", mapFaults.exrSubsampled);
  }
}

function withoutColour(names: string[]): MapFault {
  const shown = names.sort().slice(0, 16).join(", ");
  return new MapFault("environment.exr_channels", fillIn(mapFaults.exrChannels, { channels: shown }));
}

/** Return the layout that the attribute envmap states, if it is there. */
export function statedLayout({ attributes }: Stated): Layout | undefined {
  const value = attributes.get("envmap");
  return value?.byteLength === 1 ? (["latlong", "cube"] as const)[value.getUint8(0)] : undefined;
}

/** Return what to do to the pixels; throws for a picture without whole red, green and blue. */
export function checkHeader(header: Header, width: number, height: number): Shown {
  if (header.spec.deepFormat) {
    throw new MapFault("environment.exr_deep", mapFaults.exrDeep);
  }
  const names = (header.channels ?? []).map((channel) => channel.name);
  if (!["R", "G", "B"].every((name) => names.includes(name))) {
    throw withoutColour(names);
  }
  const shown = header.displayWindow;
  if (shown === undefined) throw damaged();
  const [left, top] = [shown.xMin - header.dataWindow.xMin, shown.yMin - header.dataWindow.yMin];
  const [across, down] = [shown.xMax - shown.xMin + 1, shown.yMax - shown.yMin + 1];
  const inside = left >= 0 && top >= 0 && left + across <= width && top + down <= height;
  if (!inside || across <= 0 || down <= 0) {
    throw new MapFault("environment.exr_cropped", mapFaults.exrCropped);
  }
  const stated = header.chromaticities;
  const matrix =
    stated === undefined ? null : rec709Matrix(primaries.map((name) => stated[name] ?? Number.NaN));
  if (matrix === undefined) throw new MapFault("environment.exr_primaries", mapFaults.exrPrimaries);
  return { left, top, width: across, height: down, matrix };
}

/** Return the display window of the stored picture, in Rec. 709. */
export function shownOf(
  stored: EnvironmentMap & { readonly radianceRgb: Float32Array },
  shown: Shown,
): EnvironmentMap {
  const { left, top, width, height, matrix } = shown;
  let { radianceRgb } = stored;
  if (width !== stored.width || height !== stored.height) {
    radianceRgb = new Float32Array(3 * width * height);
    for (let row = 0; row < height; row++) {
      const from = 3 * ((top + row) * stored.width + left);
      radianceRgb.set(stored.radianceRgb.subarray(from, from + 3 * width), 3 * row * width);
    }
  }
  toRec709(radianceRgb, matrix);
  return { height, width, radianceRgb };
}
