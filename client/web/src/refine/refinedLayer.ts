/** Lays a refined picture in place of the baked one, before background, exposure and tone curve. */

import { DataTexture, FloatType, RGBAFormat, type WebGLRenderTarget } from "three";
import { type FullScreen, screenProgram, setUniforms } from "../render/fullScreen.js";
import { header } from "../render/glsl.js";
import { refinedChannels } from "./status.js";
import { channels, type Look, type ViewCamera } from "../render/looks.js";
import type { RefinedPicture } from "./accumulation.js";

const fragment = `${header}
out vec4 result;
uniform sampler2D direct;
uniform sampler2D rest;
uniform vec2 corner;
uniform vec2 shownSize;
uniform float height;
uniform int channel;
void main() {
  vec2 at = corner + vec2(gl_FragCoord.x, height - gl_FragCoord.y);
  ivec2 size = textureSize(direct, 0);
  ivec2 place = clamp(ivec2(at * vec2(size) / shownSize), ivec2(0), size - 1);
  vec4 straight = texelFetch(direct, place, 0), again = texelFetch(rest, place, 0);
  vec3 shown = straight.rgb + again.rgb;
  if (channel == ${channels.direct}) shown = straight.rgb;
  if (channel == ${channels.indirect}) shown = again.rgb;
  if (channel == ${channels.visibility}) shown = vec3(again.a);
  result = vec4(shown, straight.a);
}`;

/** One refined picture on the graphics card. */
export class RefinedLayer {
  readonly #direct: DataTexture;
  readonly #rest: DataTexture;
  readonly #material = screenProgram(fragment);

  /** `shown` is the camera of the picture on the canvas, of which `picture` may be a coarser one. */
  constructor(
    readonly shown: ViewCamera,
    { width, height }: { readonly width: number; readonly height: number },
  ) {
    const table = (): DataTexture => {
      const data = new Float32Array(4 * width * height);
      const texture = new DataTexture(data, width, height, RGBAFormat, FloatType);
      texture.internalFormat = "RGBA32F";
      return texture;
    };
    this.#direct = table();
    this.#rest = table();
  }

  /** Take a new picture of the same size. */
  set(picture: RefinedPicture): void {
    const { coverage, directRgb, indirectRgb, visibility } = picture;
    const direct = this.#direct.image.data as Float32Array;
    const rest = this.#rest.image.data as Float32Array;
    coverage.forEach((share, pixel) => {
      for (let channel = 0; channel < 3; channel++) {
        direct[4 * pixel + channel] = share * directRgb[3 * pixel + channel]!;
        rest[4 * pixel + channel] = share * indirectRgb[3 * pixel + channel]!;
      }
      direct[4 * pixel + 3] = share;
      rest[4 * pixel + 3] = share * visibility[pixel]!;
    });
    this.#direct.needsUpdate = true;
    this.#rest.needsUpdate = true;
  }

  /** Draw what `camera` sees, the shown picture or a part of it; false where that is not this picture. */
  draw(screen: FullScreen, camera: ViewCamera, look: Look, target: WebGLRenderTarget): boolean {
    const { shown } = this;
    const corner = [shown.centreX - camera.centreX, shown.centreY - camera.centreY] as const;
    const inside =
      Math.min(...corner) >= 0 &&
      corner[0] + camera.width <= shown.width &&
      corner[1] + camera.height <= shown.height;
    const same =
      camera.focalX === shown.focalX &&
      camera.focalY === shown.focalY &&
      camera.cameraToWorld.every((value, index) => value === shown.cameraToWorld[index]);
    if (!inside || !same || !refinedChannels.has(look.channel)) return false;
    setUniforms(this.#material, {
      direct: this.#direct,
      rest: this.#rest,
      corner,
      shownSize: [shown.width, shown.height],
      height: camera.height,
      channel: channels[look.channel],
    });
    screen.draw(this.#material, target);
    return true;
  }

  dispose(): void {
    this.#direct.dispose();
    this.#rest.dispose();
    this.#material.dispose();
  }
}
