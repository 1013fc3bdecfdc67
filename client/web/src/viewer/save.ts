/** Pictures and films as files. */

import type { ViewerState } from "./state.js";
import { wrapped } from "./state.js";
import type { Viewer } from "./viewer.js";

/** Return the view as PNG; tone mapping is not applied twice, and alpha is straight. */
export async function pngOf(viewer: Viewer, width: number, height: number): Promise<Blob> {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  if (context === null) throw new Error("the browser gives no canvas to write a PNG with");
  context.putImageData(new ImageData(viewer.pixels(width, height), width, height), 0, 0);
  return canvas.convertToBlob({ type: "image/png" });
}

/** Return linear radiance as an uncompressed scan-line OpenEXR file of half floats, with Rec. 709 primaries. */
export function exrOf(viewer: Viewer, width: number, height: number): Blob {
  return new Blob([encodeExr(viewer.radiance(width, height), width, height)], { type: "image/x-exr" });
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

/** The kinds of film. */
export type FilmKind = "turntable" | "light";

const filmSeconds = 6;
/** Interval at which the recorder delivers data. */
const sliceMs = 50;
/** Time limit for the recorder to start. */
const patienceSeconds = 30;

/** Return the state at a moment of a film, from 0 to 1. */
export function momentOf(state: ViewerState, kind: FilmKind, moment: number): Partial<ViewerState> {
  const turned = (degrees: number): number => wrapped(degrees + 360 * moment);
  if (kind === "turntable") return { pose: { ...state.pose, azimuthDeg: turned(state.pose.azimuthDeg) } };
  return { turn: { ...state.turn, yawDeg: turned(state.turn.yawDeg) } };
}

/** Record one turn of the camera or of the light from the canvas, as WebM; the state is put back at the end. */
export async function filmOf(viewer: Viewer, kind: FilmKind, seconds = filmSeconds): Promise<Blob> {
  const type = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"].find(
    (each) => typeof MediaRecorder !== "undefined" && MediaRecorder.isTypeSupported(each),
  );
  if (type === undefined) throw new Error("this browser cannot record WebM");
  const first = viewer.state;
  const stream = viewer.canvas.captureStream(30);
  const recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: 8_000_000 });
  const parts: Blob[] = [];
  let recording = false;
  recorder.ondataavailable = ({ data }) => {
    parts.push(data);
    recording ||= data.size > 0;
  };
  const ended = new Promise<void>((resolve, reject) => {
    recorder.onstop = () => resolve();
    recorder.onerror = () => reject(new Error("the browser stopped recording; try a smaller window"));
  });
  ended.catch(() => {}); // It is awaited at the end, and may fail before.
  viewer.moving = true;
  recorder.start(sliceMs);
  const show = async (moment: number): Promise<void> => {
    await viewer.update(momentOf(first, kind, moment));
    await new Promise((resolve) => requestAnimationFrame(resolve));
  };
  try {
    // An encoder takes its time to begin, more of it on a busy machine: a film that ends before then is empty.
    const asked = performance.now();
    while (!recording && recorder.state === "recording") {
      if (performance.now() - asked > 1000 * patienceSeconds) {
        throw new Error("the browser records no picture; close other pages, or try a smaller window");
      }
      await show(0);
    }
    const start = performance.now();
    for (let moment = 0; moment < 1; moment = (performance.now() - start) / (1000 * seconds)) {
      await show(moment);
    }
  } finally {
    if (recorder.state !== "inactive") recorder.stop();
    viewer.moving = false;
    await viewer.update({ pose: first.pose, turn: first.turn });
  }
  try {
    await ended;
  } finally {
    for (const track of stream.getTracks()) track.stop();
  }
  return new Blob(parts, { type: "video/webm" });
}

/** Offer a file to the person. */
export function download(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
