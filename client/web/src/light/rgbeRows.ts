/**
 * Lines of Radiance pictures, by the rules of `lambent_core.rgbe_rows`: each line is decided for itself;
 * one that begins with (2, 2, its length) is coded. Flat pixels can begin like that, too: where a file cannot be read so,
 * all of it is taken as flat, if it then ends where the pixels do.
 */

import { fillIn, mapFaults } from "../words/words.js";

/** The end of a sentence about a file whose lines cannot be decoded. */
export class DamagedLines extends Error {}

/** Return pixels of red, green, blue and exponent, line by line; throws DamagedLines. */
export function decodeLines(data: Uint8Array, lines: number, length: number): Uint8Array {
  try {
    return lineByLine(data, lines, length);
  } catch (error) {
    const flat = error instanceof DamagedLines ? allFlat(data, lines * length) : null;
    if (flat === null) throw error;
    return flat;
  }
}

function lineByLine(data: Uint8Array, lines: number, length: number): Uint8Array {
  const pixels = new Uint8Array(4 * lines * length);
  const codable = length >= 8 && length <= 32767;
  let position = 0;
  for (let line = 0; line < lines; line++) {
    const target = pixels.subarray(4 * line * length, 4 * (line + 1) * length);
    const stated = (data[position + 2]! << 8) | data[position + 3]!;
    const coded = codable && data[position] === 2 && data[position + 1] === 2 && stated === length;
    position = coded ? readCoded(data, position + 4, target, line) : readFlat(data, position, target, line);
  }
  return pixels;
}

/** Write a line of run-length coded planes (red, green, blue, exponent) and return the position behind it. */
function readCoded(data: Uint8Array, start: number, target: Uint8Array, line: number): number {
  const length = target.length / 4;
  let position = start;
  for (let filled = 0; filled < target.length; ) {
    if (position + 1 >= data.length) throw new DamagedLines(fillIn(mapFaults.hdrRowEnds, { row: line }));
    const code = data[position++]!;
    const repeats = code > 128;
    const count = repeats ? code - 128 : code;
    if (count === 0 || filled + count > target.length || (!repeats && position + count > data.length)) {
      throw new DamagedLines(fillIn(mapFaults.hdrRowDamaged, { row: line }));
    }
    for (let index = 0; index < count; index++, filled++) {
      target[4 * (filled % length) + Math.floor(filled / length)] =
        data[repeats ? position : position + index]!;
    }
    position += repeats ? 1 : count;
  }
  return position;
}

/** Write a line of flat pixels, whose repeats end with it, and return the position behind it. */
function readFlat(data: Uint8Array, start: number, target: Uint8Array, line: number): number {
  const length = target.length / 4;
  let position = start;
  for (let filled = 0, digit = 0; filled < length; position += 4) {
    if (position + 4 > data.length) throw new DamagedLines(fillIn(mapFaults.hdrRowEnds, { row: line }));
    if (isRepeat(data, position)) {
      // Consecutive repeats are digits of one count, least significant first.
      const count = data[position + 3]! * 256 ** digit++;
      if (filled === 0 || digit > 4) throw new DamagedLines(mapFaults.hdrRepeats);
      if (filled + count > length) throw new DamagedLines(fillIn(mapFaults.hdrRowDamaged, { row: line }));
      repeat(target, filled, count);
      filled += count;
    } else {
      target.set(data.subarray(position, position + 4), 4 * filled++);
      digit = 0;
    }
  }
  return position;
}

/** Return all pixels of a file without lines, or null where it does not end with them. */
function allFlat(data: Uint8Array, number: number): Uint8Array | null {
  const pixels = new Uint8Array(4 * number);
  const end = data.length - (data.length % 4);
  let filled = 0;
  let digit = 0;
  for (let position = 0; position < end; position += 4) {
    if (filled === number) return null;
    if (isRepeat(data, position)) {
      const count = data[position + 3]! * 256 ** digit++;
      if (filled === 0 || digit > 4) return null;
      // The last repeat may run over the end, as old writers let it; nothing may follow.
      const room = Math.min(count, number - filled);
      repeat(pixels, filled, room);
      filled += room;
    } else {
      pixels.set(data.subarray(position, position + 4), 4 * filled++);
      digit = 0;
    }
  }
  return filled === number ? pixels : null;
}

function isRepeat(data: Uint8Array, position: number): boolean {
  return data[position] === 1 && data[position + 1] === 1 && data[position + 2] === 1;
}

function repeat(pixels: Uint8Array, filled: number, count: number): void {
  const last = pixels.slice(4 * (filled - 1), 4 * filled);
  for (let index = 0; index < count; index++) pixels.set(last, 4 * (filled + index));
}
