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

/** Return a target of a size: the one that there is, if any, or a new one. */
export function fitting(
  target: WebGLRenderTarget | null,
  width: number,
  height: number,
  create: (width: number, height: number) => WebGLRenderTarget,
): WebGLRenderTarget {
  if (target === null) return create(width, height);
  if (target.width !== width || target.height !== height) target.setSize(width, height);
  return target;
}
