/**
 * Radiance pictures (.hdr), read by the rules of `lambent_relight.environment.rgbe`.
 *
 * A pixel (r, g, b, e) means (r, g, b) 2^(e - 136); e = 0 is black.
 */

import type { EnvironmentMap } from "../engine/environmentMap.js";
import { MapFault, tooLarge } from "./fault.js";
import { mapFaults } from "../words/mapFaults.js";

const resolutionLine = /^([-+])Y (\d{1,7}) ([-+])X (\d{1,7})$/;

function damaged(what: string): MapFault {
  return new MapFault("environment.hdr_damaged", ...mapFaults.hdr(what));
}

/** Return the linear picture, row 0 at the top; throws MapFault. */
export function readRgbe(data: Uint8Array, maxPixels: number): EnvironmentMap {
  const { start, scale } = readHeader(data);
  const end = data.indexOf(10, start);
  const line = end > 0 && end < start + 64 ? ascii(data.subarray(start, end)) : "";
  const match = resolutionLine.exec(line);
  if (match === null) throw damaged(mapFaults.hdrNoSize);
  const [height, width] = [Number(match[2]), Number(match[4])];
  if (height === 0 || width === 0) throw damaged(mapFaults.hdrEmpty);
  if (height * width > maxPixels) throw tooLarge(width, height, maxPixels);
  const pixels = decode(data.subarray(end + 1), height, width);
  const radianceRgb = new Float32Array(3 * height * width);
  for (let row = 0; row < height; row++) {
    const from = match[1] === "+" ? height - 1 - row : row;
    for (let column = 0; column < width; column++) {
      const source = 4 * (from * width + (match[3] === "-" ? width - 1 - column : column));
      const exponent = pixels[source + 3]!;
      if (exponent === 0) continue;
      const factor = 2 ** (exponent - 136);
      const target = 3 * (row * width + column);
      for (let channel = 0; channel < 3; channel++) {
        radianceRgb[target + channel] = (pixels[source + channel]! * factor) / scale[channel]!;
      }
    }
  }
  return { height, width, radianceRgb };
}

function ascii(bytes: Uint8Array): string {
  return new TextDecoder("latin1").decode(bytes);
}

/** Return where the resolution line starts, and what stored values must be divided by. */
function readHeader(data: Uint8Array): { start: number; scale: readonly number[] } {
  const text = ascii(data.subarray(0, 1 << 16));
  if (!text.startsWith("#?RADIANCE") && !text.startsWith("#?RGBE")) {
    throw damaged(mapFaults.hdrStart);
  }
  const stop = text.indexOf("\n\n");
  if (stop < 0) throw damaged(mapFaults.hdrNoEnd);
  const scale = [1, 1, 1];
  for (const line of text.slice(0, stop).split("\n").slice(1)) {
    const [key = "", value = ""] = line.split("=", 2).map((part) => part.trim());
    if (key === "FORMAT" && value !== "32-bit_rle_rgbe") {
      throw new MapFault("environment.hdr_format", ...mapFaults.hdrFormat(value.slice(0, 32)));
    }
    if (key === "EXPOSURE" || key === "COLORCORR") {
      const numbers = value.split(/\s+/).map(Number);
      if (numbers.length !== 1 && numbers.length !== 3) throw damaged(mapFaults.hdrLine(key));
      scale.forEach((before, channel) => {
        scale[channel] = before * numbers[numbers.length === 1 ? 0 : channel]!;
      });
    }
  }
  if (!scale.every((value) => value > 0 && Number.isFinite(value))) {
    throw damaged(mapFaults.hdrExposure);
  }
  return { start: stop + 2, scale };
}

function decode(data: Uint8Array, height: number, width: number): Uint8Array {
  const coded = width >= 8 && width <= 32767 && data[0] === 2 && data[1] === 2 && data[2]! < 128;
  if (!coded) return decodeFlat(data, height * width);
  const pixels = new Uint8Array(4 * height * width);
  let position = 0;
  for (let row = 0; row < height; row++) {
    const stated = (data[position + 2]! << 8) | data[position + 3]!;
    if (data[position] !== 2 || data[position + 1] !== 2 || stated !== width) {
      throw damaged(mapFaults.hdrRowDamaged(row));
    }
    position += 4;
    for (let filled = 0; filled < 4 * width; ) {
      if (position + 1 >= data.length) throw damaged(mapFaults.hdrRowEnds(row));
      const code = data[position++]!;
      const repeated = code > 128;
      const count = repeated ? code - 128 : code;
      if (count === 0 || filled + count > 4 * width || (!repeated && position + count > data.length)) {
        throw damaged(mapFaults.hdrRowDamaged(row));
      }
      for (let index = 0; index < count; index++, filled++) {
        // Planes of a row follow each other: red, green, blue, exponent.
        const target = 4 * (row * width + (filled % width)) + Math.floor(filled / width);
        pixels[target] = data[repeated ? position : position + index]!;
      }
      position += repeated ? 1 : count;
    }
  }
  return pixels;
}

/** Return pixels stored one after another; the old format repeats by pixels (1, 1, 1, n). */
function decodeFlat(data: Uint8Array, count: number): Uint8Array {
  const pixels = new Uint8Array(4 * count);
  let filled = 0;
  let digit = 0;
  for (let place = 0; filled < count; place += 4) {
    if (place + 4 > data.length) throw damaged(mapFaults.hdrPixels(filled, count));
    if (data[place] === 1 && data[place + 1] === 1 && data[place + 2] === 1) {
      if (filled === 0 || digit > 3) throw damaged(mapFaults.hdrRepeats);
      // Consecutive repeats are digits of one count, least significant first.
      const repeats = Math.min(data[place + 3]! * 256 ** digit++, count - filled);
      const last = pixels.slice(4 * (filled - 1), 4 * filled);
      for (let index = 0; index < repeats; index++) pixels.set(last, 4 * filled++);
    } else {
      pixels.set(data.subarray(place, place + 4), 4 * filled++);
      digit = 0;
    }
  }
  return pixels;
}
