/** The resolution of a refined picture: that of the shown one, unless it would take too long. */

import type { ViewCamera } from "../render/looks.js";

/** Points that are refined at most, by what computes. */
export const mostPoints = { quick: 1 << 19, mesh: 1 << 18, slow: 1 << 14 } as const;

/** Pixels of a refined picture at most, with the object or without: each takes 64 bytes, here and on the graphics card. */
export const mostPixels = 1 << 21;

/** A picture of 1 / `step` of the shown one's sides, with `samples` x `samples` points to a pixel. */
export type RefinePlan = { readonly step: number; readonly samples: 1 | 2 };

/** Return the finest plan with at most `limit` points; `covered` is the share of pixels that show the object. */
export function planOf(width: number, height: number, covered: number, limit: number): RefinePlan {
  const all = width * height;
  const pixels = all * covered;
  if (4 * pixels <= limit && all <= mostPixels) return { step: 1, samples: 2 };
  const step = Math.ceil(Math.sqrt(Math.max(pixels / limit, all / mostPixels)));
  return { step: Math.max(1, step), samples: 1 };
}

/** Return a camera's view in another size. */
export function resized(camera: ViewCamera, width: number, height: number): ViewCamera {
  const [x, y] = [width / camera.width, height / camera.height];
  return {
    ...camera,
    ...{ width, height, focalX: camera.focalX * x, focalY: camera.focalY * y },
    ...{ centreX: camera.centreX * x, centreY: camera.centreY * y },
  };
}
