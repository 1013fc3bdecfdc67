/** Targets of half floats, which every device with WebGL 2 that we know can draw into. */

import {
  HalfFloatType,
  type MagnificationTextureFilter,
  NearestFilter,
  RGBAFormat,
  WebGLRenderTarget,
} from "three";

/** Return a target of `count` RGBA half floats without depth, read by its nearest pixel unless `filter` says otherwise. */
export function halfFloatTarget(
  width: number,
  height: number,
  filter: MagnificationTextureFilter = NearestFilter,
  count = 1,
): WebGLRenderTarget {
  return new WebGLRenderTarget(width, height, {
    ...{ format: RGBAFormat, type: HalfFloatType, minFilter: filter, magFilter: filter },
    depthBuffer: false,
    count,
  });
}
