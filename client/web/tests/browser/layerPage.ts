/** Draws a refined picture over a baked one on a real graphics card; `upscaling.browser.ts` puts it into a page. */

import {
  DataTexture,
  FloatType,
  NearestFilter,
  type PixelFormat,
  RedIntegerFormat,
  RGBAFormat,
  RGBAIntegerFormat,
  UnsignedIntType,
  WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import type { RefinedPicture } from "../../src/refine/accumulation.js";
import type { PixelFeatures } from "../../src/refine/denoise.js";
import { RefinedLayer } from "../../src/refine/refinedLayer.js";
import { FullScreen } from "../../src/render/fullScreen.js";
import type { Channel, ViewCamera } from "../../src/render/looks.js";

/** All that decides what is drawn; rows of arrays as the card has them, from below. */
export type LayerCase = {
  readonly camera: ViewCamera;
  readonly samples: number;
  readonly channel: Channel;
  readonly albedoGain: readonly [number, number, number];
  readonly done: boolean;
  readonly baked: Float32Array<ArrayBuffer>;
  readonly seen: Uint32Array<ArrayBuffer>;
  readonly facing: Uint32Array<ArrayBuffer>;
  readonly picture: RefinedPicture;
  readonly features: PixelFeatures;
};

declare global {
  var drawLayer: (given: LayerCase) => Float32Array;
}

globalThis.drawLayer = (given) => {
  const { camera, samples, channel, albedoGain, done, picture, features } = given;
  const { width, height } = camera;
  const renderer = new WebGLRenderer({ canvas: document.createElement("canvas") });
  renderer.getContext().getExtension("EXT_color_buffer_float");
  const table = (data: Uint32Array<ArrayBuffer>, format: PixelFormat, internal: "RGBA32UI" | "R32UI") => {
    const texture = new DataTexture(data, width * samples, height * samples, format, UnsignedIntType);
    texture.internalFormat = internal;
    texture.needsUpdate = true;
    return texture;
  };
  const radiance = new DataTexture(given.baked, width, height, RGBAFormat, FloatType);
  radiance.needsUpdate = true;
  const target = new WebGLRenderTarget(width, height, {
    ...{ type: FloatType, minFilter: NearestFilter, magFilter: NearestFilter, depthBuffer: false },
  });
  const layer = new RefinedLayer(camera, picture, { albedoGain, albedoScaleRgb: [1, 1, 1] }, 0);
  layer.set(picture, features, { smoothed: false, done });
  const baked = {
    ...{ radiance, mask: null, samples, live: false },
    seen: table(given.seen, RGBAIntegerFormat, "RGBA32UI"),
    facing: table(given.facing, RedIntegerFormat as PixelFormat, "R32UI"),
  };
  layer.draw(new FullScreen(renderer), camera, { channel }, baked, target);
  const found = new Float32Array(4 * width * height);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, found);
  renderer.forceContextLoss();
  return found;
};
