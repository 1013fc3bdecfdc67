/** Blends a refined picture into the baked one, before background, exposure and tone curve. */

import { DataTexture, FloatType, RGBAFormat, type WebGLRenderTarget } from "three";
import { type FullScreen, screenProgram, setUniforms } from "../render/fullScreen.js";
import { firstSample, header, unfolded } from "../render/glsl.js";
import { channels, type Look, type ViewCamera } from "../render/looks.js";
import type { Baked } from "../render/overlay.js";
import type { RefinedPicture } from "./accumulation.js";
import { refinedShares } from "./blending.js";
import type { PixelFeatures } from "./denoise.js";
import { refinedChannels } from "./status.js";
import type { RefineEdit } from "./surfacePoints.js";

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

const number = (value: number): string => value.toFixed(6);
const square = (value: number): string => `(${number(value)} * ${number(value)})`;

/**
 * A pixel of the shown picture from the refined ones around it, by joint bilateral upsampling (Kopf et al. 2007) with
 * the surface of the baked picture as a guide. Radiance is divided by the reflectance there and multiplied by the one here, so
 * that textures are as fine as in the baked picture. At full size a pixel is its own, where it has one.
 */
const fragment = `${header}${unfolded}${firstSample}
out vec4 result;
uniform sampler2D baked;
uniform usampler2D seen;
uniform usampler2D facing;
uniform sampler2D mask;
uniform bool masked;
uniform int samples;
uniform sampler2D direct;
uniform sampler2D rest;
uniform sampler2D surface;
uniform sampler2D normals;
uniform vec2 corner;
uniform vec2 shownSize;
uniform float height;
uniform int channel;
uniform vec3 albedoGain;
uniform float arrived;
uniform float settled;

vec3 shownOf(ivec2 place) {
  vec4 straight = texelFetch(direct, place, 0), again = texelFetch(rest, place, 0);
  if (channel == ${channels.direct}) return straight.rgb;
  if (channel == ${channels.indirect}) return again.rgb;
  if (channel == ${channels.visibility}) return vec3(again.a);
  return straight.rgb + again.rgb;
}

/** What is refined here, and how much of it to show. */
vec4 refined(ivec2 first, vec2 at) {
  ivec2 size = textureSize(direct, 0);
  vec2 place = at * vec2(size) / shownSize;
  ivec2 middle = clamp(ivec2(place), ivec2(0), size - 1);
  if (vec2(size) == shownSize && texelFetch(direct, middle, 0).a > 0.0) {
    return vec4(shownOf(middle), texelFetch(direct, middle, 0).a);
  }
  float count = 0.0, distance = 0.0;
  vec3 albedo = vec3(0.0), normal = vec3(0.0);
  for (int index = 0; index < samples * samples; index++) {
    ivec2 sampled = first + ivec2(index % samples, index / samples);
    uvec4 found = texelFetch(seen, sampled, 0);
    if (found.g == 0u) continue;
    count += 1.0;
    distance += uintBitsToFloat(found.g);
    albedo += vec3(unpackUnorm2x16(found.b), unpackUnorm2x16(found.a).x);
    normal += unfolded(texelFetch(facing, sampled, 0).r);
  }
  if (count == 0.0) return vec4(0.0);
  albedo = clamp(albedo / count * albedoGain, 0.0, 1.0);
  normal /= count;
  distance = log(distance / count);
  bool lit = channel != ${channels.visibility};
  vec4 sum = vec4(0.0);
  float total = 0.0;
  for (int i = -${upscaling.reach}; i <= ${upscaling.reach}; i++) {
    for (int j = -${upscaling.reach}; j <= ${upscaling.reach}; j++) {
      ivec2 other = middle + ivec2(j, i);
      if (any(lessThan(other, ivec2(0))) || any(greaterThanEqual(other, size))) continue;
      float share = texelFetch(direct, other, 0).a;
      if (share <= 0.0) continue;
      vec4 behind = texelFetch(surface, other, 0);
      vec2 away = vec2(other) + 0.5 - place;
      vec3 paint = behind.rgb - albedo, slope = texelFetch(normals, other, 0).rgb - normal;
      float depth = log(behind.a) - distance;
      float weight = exp(-dot(away, away) / (2.0 * ${square(upscaling.spread)})
        - dot(paint, paint) / ${square(upscaling.albedo)} - dot(slope, slope) / ${square(upscaling.normal)}
        - depth * depth / ${square(upscaling.distance)});
      vec3 reflectance = lit ? (albedo + ${number(leastReflectance)}) / (behind.rgb + ${number(leastReflectance)}) : vec3(1.0);
      sum += weight * vec4(reflectance * shownOf(other), share);
      total += weight;
    }
  }
  return total < ${leastWeight} ? vec4(0.0) : sum / total;
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 before = texelFetch(baked, pixel, 0);
  if (before.a <= 0.0) {
    result = before;
    return;
  }
  ivec2 first = firstSample(seen, pixel * samples, masked, masked ? texelFetch(mask, pixel, 0).r : 1.0);
  vec4 finer = refined(first, corner + vec2(gl_FragCoord.x, height - gl_FragCoord.y));
  float share = finer.a > 0.0 ? arrived * mix(finer.a, 1.0, settled) : 0.0;
  result = vec4(mix(min(before.rgb, 65504.0), before.a * finer.rgb, share), before.a);
}`;

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

  /** Go on to what is drawn now, and return how far that is: 0 at first, 1 in the end. */
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
  readonly #material = screenProgram(fragment);
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
