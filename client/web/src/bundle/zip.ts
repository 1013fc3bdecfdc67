/**
 * Zip archives, read in parts: from a file that was dropped, or by ranges of an address. By hand, because the reader of
 * @zip.js/zip.js weighs 25 KB compressed, in a worker that every viewer loads, and this module 1.7 KB with its faults.
 */

import { inflated } from "../page/buffers.js";
import { BundleFault, fetchAgain, unsafe } from "../page/fault.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** Some bytes of a file; `start` may be negative, counted from the end. */
export type RangeReader = (start: number, length: number) => Promise<Uint8Array<ArrayBuffer>>;

type Entry = {
  readonly method: number;
  readonly sizeBytes: number;
  readonly packedBytes: number;
  readonly offset: number;
};

const endMark = 0x06054b50;
const entryMark = 0x02014b50;
const fileMark = 0x04034b50;
const maxFiles = 4096;

function damaged(what: string): BundleFault {
  return fetchAgain("bundle.archive_damaged", fillIn(bundleFaults.archive, { what }));
}

/** An archive whose directory has been read. */
export class ZipArchive {
  private constructor(
    readonly entries: ReadonlyMap<string, Entry>,
    private readonly read: RangeReader,
  ) {}

  /** Read the directory of an archive in memory or on disk; throws BundleFault. */
  static ofFile(file: Blob): Promise<ZipArchive> {
    const read: RangeReader = async (start, length) =>
      new Uint8Array(await file.slice(start, start + length).arrayBuffer());
    return ZipArchive.open(read, file.size);
  }

  /** Read the directory of an archive of `totalBytes`; throws BundleFault for anything but a plain zip. */
  static async open(read: RangeReader, totalBytes: number): Promise<ZipArchive> {
    const tailLength = Math.min(totalBytes, 65_557);
    const tail = await read(totalBytes - tailLength, tailLength);
    const view = new DataView(tail.buffer, tail.byteOffset, tail.byteLength);
    let end = tail.length - 22;
    while (end >= 0 && view.getUint32(end, true) !== endMark) end--;
    if (end < 0) throw damaged(bundleFaults.noDirectory);
    const count = view.getUint16(end + 10, true);
    const length = view.getUint32(end + 12, true);
    const start = view.getUint32(end + 16, true);
    if (count === 0xffff || start === 0xffffffff || start + length > totalBytes) {
      throw damaged(bundleFaults.largeOrCut);
    }
    if (count > maxFiles) {
      throw unsafe("bundle.too_many_files", fillIn(bundleFaults.tooManyFiles, { most: maxFiles }));
    }
    const directory = await read(start, length);
    return new ZipArchive(parseDirectory(directory, count), read);
  }

  /** Return the bytes of a file of the archive. */
  async file(name: string): Promise<Uint8Array<ArrayBuffer>> {
    const entry = this.entries.get(name);
    if (entry === undefined) throw damaged(fillIn(bundleFaults.noEntry, { name }));
    const head = await this.read(entry.offset, 30);
    const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
    if (head.length < 30 || view.getUint32(0, true) !== fileMark)
      throw damaged(fillIn(bundleFaults.damagedAt, { name }));
    const start = entry.offset + 30 + view.getUint16(26, true) + view.getUint16(28, true);
    const packed = await this.read(start, entry.packedBytes);
    if (packed.length !== entry.packedBytes) throw damaged(fillIn(bundleFaults.endsIn, { name }));
    if (entry.method === 0) return packed;
    const found = await inflated(packed, "deflate-raw", entry.sizeBytes);
    if (found === null) throw damaged(fillIn(bundleFaults.packedAt, { name }));
    if (found.length > entry.sizeBytes) throw damaged(fillIn(bundleFaults.holdsMore, { name }));
    if (found.length < entry.sizeBytes) throw damaged(fillIn(bundleFaults.holdsLess, { name }));
    return found.bytes;
  }
}

function parseDirectory(directory: Uint8Array, count: number): Map<string, Entry> {
  const view = new DataView(directory.buffer, directory.byteOffset, directory.byteLength);
  const entries = new Map<string, Entry>();
  let place = 0;
  for (let index = 0; index < count; index++) {
    if (place + 46 > directory.length || view.getUint32(place, true) !== entryMark) {
      throw damaged(bundleFaults.directoryDamaged);
    }
    const flags = view.getUint16(place + 8, true);
    const nameLength = view.getUint16(place + 28, true);
    const rest = view.getUint16(place + 30, true) + view.getUint16(place + 32, true);
    const name = new TextDecoder().decode(directory.subarray(place + 46, place + 46 + nameLength));
    const kind = (view.getUint32(place + 38, true) >>> 28) & 0xf;
    const entry = {
      method: view.getUint16(place + 10, true),
      packedBytes: view.getUint32(place + 20, true),
      sizeBytes: view.getUint32(place + 24, true),
      offset: view.getUint32(place + 42, true),
    };
    place += 46 + nameLength + rest;
    if (name.endsWith("/")) continue;
    if (flags & 1) throw new BundleFault("bundle.encrypted", fillIn(bundleFaults.encrypted, { name }));
    if (kind !== 0 && kind !== 8) {
      throw new BundleFault("bundle.not_a_plain_file", fillIn(bundleFaults.notPlain, { name }));
    }
    if (entry.method !== 0 && entry.method !== 8)
      throw damaged(fillIn(bundleFaults.unknownPacking, { name }));
    if (entries.has(name)) throw damaged(fillIn(bundleFaults.holdsTwice, { name }));
    entries.set(name, entry);
  }
  return entries;
}
