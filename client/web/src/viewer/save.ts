/** Pictures as files. */

import type { Viewer } from "./viewer.js";
import { deviceFaults } from "../words/words.js";

/** Return the view as PNG; tone mapping is not applied twice, and alpha is straight. */
export function pngOf(viewer: Viewer, width: number, height: number): Promise<Blob> {
  return pngFrom(viewer.pixels(width, height), width, height);
}

/** Return straight RGBA bytes, rows from the top, as PNG. */
export async function pngFrom(
  rgba: Uint8ClampedArray<ArrayBuffer>,
  width: number,
  height: number,
): Promise<Blob> {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  if (context === null) throw new Error(deviceFaults.noCanvas);
  context.putImageData(new ImageData(rgba, width, height), 0, 0);
  return canvas.convertToBlob({ type: "image/png" });
}

/** Return linear radiance as an uncompressed scan-line OpenEXR file of half floats, with Rec. 709 primaries. */
export function exrOf(viewer: Viewer, width: number, height: number): Blob {
  return exrFrom(viewer.radiance(width, height), width, height);
}

/** Return half floats as `encodeExr` takes them as an EXR file. */
export function exrFrom(halfRgba: Uint16Array, width: number, height: number): Blob {
  return new Blob([encodeExr(halfRgba, width, height)], { type: "image/x-exr" });
}

/** Return an EXR file of RGBA half floats, rows from the top, colours multiplied by alpha. */
export function encodeExr(halfRgba: Uint16Array, width: number, height: number): Uint8Array<ArrayBuffer> {
  const names = ["A", "B", "G", "R"];
  const sources = [3, 2, 1, 0];
  const text = new TextEncoder();
  const header: number[] = [0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
  const int = (...values: number[]): number[] => [...new Uint8Array(Int32Array.from(values).buffer)];
  const float = (...values: number[]): number[] => [...new Uint8Array(Float32Array.from(values).buffer)];
  const attribute = (name: string, type: string, value: number[]): void => {
    header.push(...text.encode(name), 0, ...text.encode(type), 0, ...int(value.length), ...value);
  };
  attribute("channels", "chlist", [
    ...names.flatMap((name) => [...text.encode(name), 0, ...int(1, 0, 1, 1)]),
    0,
  ]);
  attribute("chromaticities", "chromaticities", float(0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329));
  attribute("compression", "compression", [0]);
  attribute("dataWindow", "box2i", int(0, 0, width - 1, height - 1));
  attribute("displayWindow", "box2i", int(0, 0, width - 1, height - 1));
  attribute("lineOrder", "lineOrder", [0]);
  attribute("pixelAspectRatio", "float", float(1));
  attribute("screenWindowCenter", "v2f", float(0, 0));
  attribute("screenWindowWidth", "float", float(1));
  header.push(0);
  const lineBytes = 8 + 8 * width;
  const start = header.length + 8 * height;
  const file = new Uint8Array(start + lineBytes * height);
  file.set(header);
  const view = new DataView(file.buffer);
  for (let row = 0; row < height; row++) {
    const at = start + row * lineBytes;
    view.setBigUint64(header.length + 8 * row, BigInt(at), true);
    view.setInt32(at, row, true);
    view.setInt32(at + 4, 8 * width, true);
    sources.forEach((source, plane) => {
      for (let column = 0; column < width; column++) {
        const value = halfRgba[4 * (row * width + column) + source]!;
        view.setUint16(at + 8 + 2 * (plane * width + column), value, true);
      }
    });
  }
  return file;
}

/** Offer a file to the person. */
export function download(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
