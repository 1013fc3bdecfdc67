/** The resolution of a refined picture: that of the shown one, unless it would take too long. */

import type { ViewCamera } from "../render/looks.js";

/** Points that are refined at most, by what computes. */
export const mostPoints = { quick: 1 << 19, mesh: 1 << 18, slow: 1 << 14 } as const;

/** A picture of 1 / `step` of the shown one's sides, with `samples` x `samples` points to a pixel. */
export type RefinePlan = { readonly step: number; readonly samples: 1 | 2 };

/** Return the finest plan with at most `limit` points; `covered` is the share of pixels that show the object. */
export function planOf(width: number, height: number, covered: number, limit: number): RefinePlan {
  const pixels = width * height * covered;
  if (4 * pixels <= limit) return { step: 1, samples: 2 };
  return { step: Math.max(1, Math.ceil(Math.sqrt(pixels / limit))), samples: 1 };
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
