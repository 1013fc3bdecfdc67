/**
 * Radiance pictures (.hdr), read by the rules of `lambent_core.rgbe`.
 *
 * A pixel (r, g, b, e) means (r, g, b) 2^(e - 136); e = 0 is black.
 */

import type { Matrix3 } from "three";
import type { EnvironmentMap } from "../engine/environmentMap.js";
import { MapFault, tooLarge } from "../page/fault.js";
import { rec709Matrix, toRec709 } from "./primaries.js";
import { DamagedLines, decodeLines } from "./rgbeRows.js";
import { fillIn, mapFaults } from "../words/words.js";

const resolutionLine = /^([-+])([XY]) (\d{1,7}) ([-+])([XY]) (\d{1,7})$/;

function damaged(what: string): MapFault {
  return new MapFault("environment.hdr_damaged", fillIn(mapFaults.hdr, { what }));
}

/** Return the linear Rec. 709 picture, row 0 at the top whatever the scan order; throws MapFault. */
export function readRgbe(data: Uint8Array, maxPixels: number): EnvironmentMap {
  const { start, scale, matrix } = readHeader(data);
  const end = data.indexOf(10, start);
  const line = end > 0 && end < start + 64 ? ascii(data.subarray(start, end)) : "";
  const match = resolutionLine.exec(line);
  if (match === null || match[2] === match[5]) throw damaged(mapFaults.hdrNoSize);
  const byColumns = match[2] === "X";
  const [lines, length] = [Number(match[3]), Number(match[6])];
  const [height, width] = byColumns ? [length, lines] : [lines, length];
  if (height === 0 || width === 0) throw damaged(mapFaults.hdrEmpty);
  if (height * width > maxPixels) throw tooLarge(width, height, maxPixels);
  const pixels = linesOf(data.subarray(end + 1), lines, length);
  const signOf = (axis: string): string => (match[2] === axis ? match[1]! : match[4]!);
  const [upwards, leftwards] = [signOf("Y") === "+", signOf("X") === "-"];
  const radianceRgb = new Float32Array(3 * height * width);
  for (let row = 0; row < height; row++) {
    const down = upwards ? height - 1 - row : row;
    for (let column = 0; column < width; column++) {
      const across = leftwards ? width - 1 - column : column;
      const source = 4 * (byColumns ? across * height + down : down * width + across);
      const exponent = pixels[source + 3]!;
      if (exponent === 0) continue;
      const factor = 2 ** (exponent - 136);
      const target = 3 * (row * width + column);
      for (let channel = 0; channel < 3; channel++) {
        radianceRgb[target + channel] = (pixels[source + channel]! * factor) / scale[channel]!;
      }
    }
  }
  toRec709(radianceRgb, matrix);
  return { height, width, radianceRgb };
}

function linesOf(data: Uint8Array, lines: number, length: number): Uint8Array {
  try {
    return decodeLines(data, lines, length);
  } catch (error) {
    throw error instanceof DamagedLines ? damaged(error.message) : error;
  }
}

function ascii(bytes: Uint8Array): string {
  return new TextDecoder("latin1").decode(bytes);
}

type RgbeHeader = {
  /** Where the resolution line starts. */
  readonly start: number;
  /** What stored values must be divided by. */
  readonly scale: readonly number[];
  /** From the stated primaries to Rec. 709. */
  readonly matrix: Matrix3 | null;
};

function readHeader(data: Uint8Array): RgbeHeader {
  const text = ascii(data.subarray(0, 1 << 16));
  if (!text.startsWith("#?RADIANCE") && !text.startsWith("#?RGBE")) {
    throw damaged(mapFaults.hdrStart);
  }
  const stop = text.indexOf("\n\n");
  if (stop < 0) throw damaged(mapFaults.hdrNoEnd);
  const scale = [1, 1, 1];
  let matrix: Matrix3 | null = null;
  for (const line of text.slice(0, stop).split("\n").slice(1)) {
    const [key = "", value = ""] = line.split("=", 2).map((part) => part.trim());
    if (key === "FORMAT" && value !== "32-bit_rle_rgbe") {
      throw new MapFault(
        "environment.hdr_format",
        fillIn(mapFaults.hdrFormat, { format: value.slice(0, 32) }),
      );
    }
    if (key === "EXPOSURE" || key === "COLORCORR") {
      const numbers = value.split(/\s+/).map(Number);
      if (numbers.length !== 1 && numbers.length !== 3) throw damaged(fillIn(mapFaults.hdrLine, { key }));
      scale.forEach((before, channel) => {
        scale[channel] = before * numbers[numbers.length === 1 ? 0 : channel]!;
      });
    }
    if (key === "PRIMARIES") {
      const found = rec709Matrix(value.split(/\s+/).map(Number));
      if (found === undefined) throw damaged(fillIn(mapFaults.hdrLine, { key }));
      matrix = found;
    }
  }
  if (!scale.every((value) => value > 0 && Number.isFinite(value))) {
    throw damaged(mapFaults.hdrExposure);
  }
  return { start: stop + 2, scale, matrix };
}
