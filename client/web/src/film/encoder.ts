/** Films as files: frames in, MP4 or WebM out, by the encoders of the browser (WebCodecs). */

import {
  BufferTarget,
  canEncodeVideo,
  Mp4OutputFormat,
  Output,
  QUALITY_VERY_HIGH,
  type VideoCodec,
  VideoSample,
  VideoSampleSource,
  WebMOutputFormat,
} from "mediabunny";
import { Fault } from "../page/fault.js";
import type { FilmFormat, FilmPlan } from "./plan.js";
import { fillIn, texts } from "../words/words.js";

/** Codecs of a format, the most widely supported first. */
const codecs: Readonly<Record<FilmFormat, readonly VideoCodec[]>> = {
  mp4: ["avc", "hevc", "av1", "vp9"],
  webm: ["vp9", "av1", "vp8"],
};

/** Names of codecs as people know them. */
export const codecNames: Readonly<Record<string, string>> = {
  avc: "H.264",
  hevc: "H.265",
  av1: "AV1",
  vp9: "VP9",
  vp8: "VP8",
};

const quality = QUALITY_VERY_HIGH;

type Size = Pick<FilmPlan, "width" | "height" | "framesPerSecond">;

/**
 * Return the codec that this browser encodes a format with. Throws the fault `film.unsupported` where it has none for
 * this size.
 */
export async function codecFor(format: FilmFormat, size: Size): Promise<VideoCodec> {
  if (typeof VideoEncoder === "undefined") {
    throw new Fault("film.unsupported", texts.film.noEncoder);
  }
  const { width, height, framesPerSecond: frameRate } = size;
  for (const codec of codecs[format]) {
    if (await canEncodeVideo(codec, { width, height, frameRate, quality })) return codec;
  }
  throw new Fault("film.unsupported", fillIn(texts.film.notEncoded, { format, width, height }));
}

/** A film being written. */
export type FilmWriter = {
  readonly codec: VideoCodec;
  /** Add the next frame: opaque RGBA bytes, sRGB-encoded, rows from the top. */
  readonly add: (rgba: Uint8ClampedArray<ArrayBuffer>) => Promise<void>;
  readonly finish: () => Promise<Blob>;
  /** Discard the film. */
  readonly cancel: () => Promise<void>;
};

/** Begin a film. */
export async function beginFilm(plan: FilmPlan): Promise<FilmWriter> {
  const { width, height, framesPerSecond } = plan;
  const codec = await codecFor(plan.format, plan);
  const target = new BufferTarget();
  const format =
    plan.format === "mp4" ? new Mp4OutputFormat({ fastStart: "in-memory" }) : new WebMOutputFormat();
  const output = new Output({ format, target });
  const source = new VideoSampleSource({ codec, quality });
  output.addVideoTrack(source, { frameRate: framesPerSecond });
  await output.start();
  let frame = 0;
  return {
    codec,
    add: async (rgba) => {
      const sample = new VideoSample(rgba, {
        format: "RGBX",
        codedWidth: width,
        codedHeight: height,
        timestamp: frame / framesPerSecond,
        duration: 1 / framesPerSecond,
      });
      frame++;
      try {
        await source.add(sample);
      } finally {
        sample.close();
      }
    },
    finish: async () => {
      await output.finalize();
      return new Blob([target.buffer!], { type: plan.format === "mp4" ? "video/mp4" : "video/webm" });
    },
    cancel: () => output.cancel(),
  };
}
