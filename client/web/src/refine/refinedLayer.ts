/** Blends a refined picture into the baked one, before background, exposure and tone curve. */

import { DataTexture, FloatType, RGBAFormat, type WebGLRenderTarget } from "three";
import { type FullScreen, screenProgram, setUniforms } from "../render/fullScreen.js";
import { channels, type Look, type ViewCamera } from "../render/looks.js";
import type { Baked } from "../render/overlay.js";
import { float } from "../render/shaders.js";
import samples from "../render/shaders/samples.glsl?raw";
import type { RefinedPicture } from "./accumulation.js";
import { refinedShares } from "./blending.js";
import type { PixelFeatures } from "./denoise.js";
import { refinedChannels } from "./status.js";
import type { RefineEdit } from "./surfacePoints.js";
import fragment from "./upscaling.frag.glsl?raw";

/**
 * Pixels of the refined picture to either side of a pixel of the shown one that take part, and how they are weighted:
 * by their distance (the standard deviation of a Gaussian, in their own size), and by the differences of albedo, of
 * normals (a length) and of the distance from the camera (as a share) at which they count 1/e.
 */
export const upscaling = { reach: 2, spread: 0.6, albedo: 0.15, normal: 0.3, distance: 0.02 } as const;
/** Reflectance that every surface has besides its albedo. */
export const leastReflectance = 0.04;
/** Weights below this in all are of pixels that show something else. */
export const leastWeight = 1e-4;

const macros = {
  REACH: upscaling.reach,
  SPREAD: float(upscaling.spread),
  ALBEDO_SCALE: float(upscaling.albedo),
  NORMAL_SCALE: float(upscaling.normal),
  DISTANCE_SCALE: float(upscaling.distance),
  LEAST_REFLECTANCE: float(leastReflectance),
  LEAST_WEIGHT: float(leastWeight),
};

/** Frames that take longer count as this long, so that nothing jumps where drawing is slow; ms. */
const longestFrameMs = 80;

/** How far a change of the picture has come. */
class Fade {
  #passedMs = 0;
  #drawnAt: number | null = null;

  constructor(private readonly lengthMs: number) {}

  /** Whether it has begun and is not over. */
  get isRunning(): boolean {
    return this.#drawnAt !== null && this.#passedMs < this.lengthMs;
  }

  /** Advance to the frame that is drawn now, and return its progress: 0 at first, 1 in the end. */
  next(): number {
    if (this.lengthMs <= 0) return 1;
    const now = performance.now();
    if (this.#drawnAt !== null) this.#passedMs += Math.min(now - this.#drawnAt, longestFrameMs);
    this.#drawnAt = now;
    const share = Math.min(this.#passedMs / this.lengthMs, 1);
    return share * share * (3 - 2 * share);
  }
}

/** One refined picture on the graphics card. */
export class RefinedLayer {
  readonly #direct: DataTexture;
  readonly #rest: DataTexture;
  readonly #surface: DataTexture;
  readonly #normals: DataTexture;
  readonly #material = screenProgram([samples, fragment], macros);
  readonly #arriving: Fade;
  readonly #settling: Fade;
  #isDone = false;

  /**
   * `shown` is the camera of the picture on the canvas, of which `picture` may be a coarser one; `fadeMs` is how long
   * the refined picture takes to come in place of the baked one.
   */
  constructor(
    readonly shown: ViewCamera,
    { width, height }: { readonly width: number; readonly height: number },
    private readonly edit: Pick<RefineEdit, "albedoGain" | "albedoScaleRgb">,
    fadeMs: number,
  ) {
    const table = (): DataTexture => {
      const data = new Float32Array(4 * width * height);
      const texture = new DataTexture(data, width, height, RGBAFormat, FloatType);
      texture.internalFormat = "RGBA32F";
      return texture;
    };
    [this.#direct, this.#rest] = [table(), table()];
    [this.#surface, this.#normals] = [table(), table()];
    this.#arriving = new Fade(fadeMs);
    this.#settling = new Fade(fadeMs);
  }

  /** Whether it is still on its way, so that the next frame is another one. */
  get isFading(): boolean {
    return this.#arriving.isRunning || this.#settling.isRunning;
  }

  /**
   * Take a new picture of the same size, and what stands behind it where that is not known yet; `smoothed` if there is
   * less noise in it than its errors say. One that is done is shown for itself.
   */
  set(
    picture: RefinedPicture,
    features: PixelFeatures | null,
    { smoothed, done }: { readonly smoothed: boolean; readonly done: boolean },
  ): void {
    const { directRgb, indirectRgb, visibility } = picture;
    const shares = refinedShares(picture, smoothed);
    fill(this.#direct, directRgb, shares);
    fill(this.#rest, indirectRgb, visibility);
    if (features !== null) {
      fill(this.#surface, features.albedo, features.distance);
      fill(this.#normals, features.normal, null);
    }
    this.#isDone = done;
  }

  /** Whether it shows what `camera` sees: the shown picture or a part of it. */
  shows(camera: ViewCamera, { channel }: Pick<Look, "channel">): boolean {
    const { shown } = this;
    const corner = cornerOf(camera, shown);
    const inside =
      Math.min(...corner) >= 0 &&
      corner[0] + camera.width <= shown.width &&
      corner[1] + camera.height <= shown.height;
    const same =
      camera.focalX === shown.focalX &&
      camera.focalY === shown.focalY &&
      camera.cameraToWorld.every((value, index) => value === shown.cameraToWorld[index]);
    return inside && same && refinedChannels.has(channel);
  }

  /** Draw what `camera` sees, blended into the baked picture. */
  draw(
    screen: FullScreen,
    camera: ViewCamera,
    { channel }: Pick<Look, "channel">,
    { radiance, seen, facing, mask, samples, live }: Baked,
    target: WebGLRenderTarget,
  ): void {
    const { shown, edit } = this;
    const gain = edit.albedoGain.map((value, axis) => value * edit.albedoScaleRgb[axis]!);
    setUniforms(this.#material, {
      ...{ baked: radiance, seen, facing, mask, masked: mask !== null, samples },
      ...{ direct: this.#direct, rest: this.#rest, surface: this.#surface, normals: this.#normals },
      corner: cornerOf(camera, shown),
      shownSize: [shown.width, shown.height],
      height: camera.height,
      channel: channels[channel],
      albedoGain: gain,
      arrived: live ? this.#arriving.next() : 1,
      settled: this.#isDone ? (live ? this.#settling.next() : 1) : 0,
    });
    screen.draw(this.#material, target);
  }

  dispose(): void {
    for (const each of [this.#direct, this.#rest, this.#surface, this.#normals]) each.dispose();
    this.#material.dispose();
  }
}

/** Return where a camera's picture begins in another one of the same view. */
function cornerOf(camera: ViewCamera, whole: ViewCamera): readonly [number, number] {
  return [whole.centreX - camera.centreX, whole.centreY - camera.centreY];
}

/** Write triples and numbers into a texture. */
function fill(texture: DataTexture, rgb: Float32Array, alpha: Float32Array | null): void {
  const data = texture.image.data as Float32Array;
  for (let pixel = 0; 4 * pixel < data.length; pixel++) {
    for (let channel = 0; channel < 3; channel++) data[4 * pixel + channel] = rgb[3 * pixel + channel]!;
    if (alpha !== null) data[4 * pixel + 3] = alpha[pixel]!;
  }
  texture.needsUpdate = true;
}
