/** Reads and checks the header of an OpenEXR file, like `lambent_relight.environment.exr`. */

import { MapFault, tooLarge } from "./fault.js";
import { mapFaults } from "../words/mapFaults.js";

const rec709 = [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329];
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

/** The attributes of a file's first part: where the value of each lies. */
export type Stated = {
  /** Bits of the second to fourth byte of the version: tiles 2, deep 8, several parts 16. */
  readonly flags: number;
  readonly attributes: ReadonlyMap<string, DataView>;
  /** Offset of the end of the header. */
  readonly end: number;
};

/** Return the fault of a file that is no whole OpenEXR picture. */
export function damaged(): MapFault {
  return new MapFault("environment.exr_damaged", ...mapFaults.exrDamaged());
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
  const attributes = new Map<string, DataView>();
  let known = false;
  let first = true;
  for (let more = true; more; ) {
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
      if (first) attributes.set(name, new DataView(data.buffer, data.byteOffset + place, size));
      place += size;
    }
    first = false;
    more = severalParts && data[place] !== 0;
  }
  if (!known) throw damaged();
  return { flags, attributes, end: place };
}

/** Throw for a picture that is not a whole one of red, green and blue in linear Rec. 709. */
export function checkHeader(header: Header, width: number, height: number): void {
  if (header.spec.deepFormat) {
    throw new MapFault("environment.exr_deep", ...mapFaults.exrDeep());
  }
  const names = (header.channels ?? []).map((channel) => channel.name);
  if (!["R", "G", "B"].every((name) => names.includes(name))) {
    throw new MapFault(
      "environment.exr_channels",
      ...mapFaults.exrChannels(names.sort().slice(0, 16).join(", ")),
    );
  }
  const shown = header.displayWindow;
  if (shown === undefined) throw damaged();
  if (shown.xMax - shown.xMin + 1 !== width || shown.yMax - shown.yMin + 1 !== height) {
    throw new MapFault("environment.exr_cropped", ...mapFaults.exrCropped());
  }
  const stated = header.chromaticities;
  if (stated === undefined) return;
  const found = primaries.map((name) => stated[name] ?? Number.NaN);
  if (!found.every((value, index) => Math.abs(value - rec709[index]!) < 2e-3)) {
    throw new MapFault("environment.exr_primaries", ...mapFaults.exrPrimaries());
  }
}
