/**
 * OpenEXR files of whole lines of half floats, uncompressed or deflated by 16 lines.
 *
 * Source: the OpenEXR file layout (openexr.com): after the header a table of chunk offsets; a chunk is its first line,
 * its size, and planes by line. Deflated bytes are differences of neighbours, first those at even places.
 */

import { halfTable } from "../engine/half.js";
import { inflated } from "../page/buffers.js";
import { channelsOf, damaged, type Shown, type Stated } from "./exrHeader.js";

/** The layout of the lines in such a file. */
export type HalfLines = {
  readonly stored: Shown["stored"];
  /** Lines in a chunk; those of one line are not compressed. */
  readonly linesPerChunk: 1 | 16;
  readonly tableStart: number;
  readonly numChannels: number;
  /** Indices of the red, green and blue channels. */
  readonly rgb: readonly number[];
};

const half = 1;

/** Return the layout of a file's lines, or null if it is of another kind. */
export function halfLinesOf({ flags, attributes, end }: Stated, { stored }: Shown): HalfLines | null {
  const compression = attributes.get("compression");
  if (flags & ~4 || compression?.byteLength !== 1 || typeof DecompressionStream === "undefined") return null;
  const linesPerChunk = ({ 0: 1, 3: 16 } as const)[compression.getUint8(0)];
  const channels = channelsOf(attributes.get("channels"));
  const plain = channels.every(
    ({ type, xSampling, ySampling }) => type === half && xSampling === 1 && ySampling === 1,
  );
  if (linesPerChunk === undefined || !plain) return null;
  const rgb = ["R", "G", "B"].map((name) => channels.findIndex((channel) => channel.name === name));
  return { stored, linesPerChunk, tableStart: end, numChannels: channels.length, rgb };
}

/** Return the stored picture, row 0 at the top; throws MapFault for a damaged one. */
export async function readHalfLines(data: Uint8Array<ArrayBuffer>, lines: HalfLines): Promise<Float32Array> {
  const { linesPerChunk, tableStart } = lines;
  const { width, height, firstLine } = lines.stored;
  const numChunks = Math.ceil(height / linesPerChunk);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  if (tableStart + 8 * numChunks > data.length) throw damaged();
  const radianceRgb = new Float32Array(3 * width * height);
  const seen = new Uint8Array(numChunks);
  const readChunk = async (chunk: number): Promise<void> => {
    const start = Number(view.getBigUint64(tableStart + 8 * chunk, true));
    if (start + 8 > data.length) throw damaged();
    const row = view.getInt32(start, true) - firstLine;
    const size = view.getInt32(start + 4, true);
    const place = row / linesPerChunk;
    if (!(place >= 0 && place < numChunks && Number.isInteger(place)) || seen[place] !== 0) throw damaged();
    if (size < 0 || start + 8 + size > data.length) throw damaged();
    seen[place] = 1;
    const numLines = Math.min(linesPerChunk, height - row);
    const stored = data.subarray(start + 8, start + 8 + size);
    const numBytes = 2 * numLines * width * lines.numChannels;
    if (size > numBytes || (linesPerChunk === 1 && size !== numBytes)) throw damaged();
    const bytes = size === numBytes ? stored.slice() : undone(await unpacked(stored, numBytes));
    writeLines(new Uint16Array(bytes.buffer), lines, row, numLines, radianceRgb);
  };
  await Promise.all(Array.from(seen, (_, chunk) => readChunk(chunk)));
  return radianceRgb;
}

function writeLines(
  halves: Uint16Array,
  { stored: { width }, numChannels, rgb }: HalfLines,
  row: number,
  numLines: number,
  radianceRgb: Float32Array,
): void {
  const table = halfTable();
  for (let line = 0; line < numLines; line++) {
    for (let channel = 0; channel < 3; channel++) {
      const from = (line * numChannels + rgb[channel]!) * width;
      const to = 3 * (row + line) * width + channel;
      for (let column = 0; column < width; column++) {
        radianceRgb[to + 3 * column] = table[halves[from + column]!]!;
      }
    }
  }
}

async function unpacked(stored: Uint8Array<ArrayBuffer>, numBytes: number): Promise<Uint8Array> {
  const found = await inflated(stored, "deflate", numBytes);
  if (found?.length !== numBytes) throw damaged();
  return found.bytes;
}

/** Return bytes put back from their differences, even and odd places from the two halves. */
function undone(stored: Uint8Array): Uint8Array<ArrayBuffer> {
  const bytes = new Uint8Array(stored.length);
  const middle = (stored.length + 1) >> 1;
  let value = 128;
  for (let at = 0; at < middle; at++) {
    value += stored[at]! - 128;
    bytes[2 * at] = value;
  }
  for (let at = middle; at < stored.length; at++) {
    value += stored[at]! - 128;
    bytes[2 * (at - middle) + 1] = value;
  }
  return bytes;
}
