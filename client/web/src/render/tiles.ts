/** Parts of pictures that are too large to be drawn at once. */

import type { ViewCamera } from "./looks.js";

/** A rectangle of a picture, pixels from its top left. */
export type Part = {
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
};

/** Samples that are drawn at once at most, 24 bytes each: those of 1920 x 1080 pixels with 2 x 2 of them fit. */
export const mostSamples = 1 << 23;

/** Return the parts of a picture, row by row, at most `across` x `down` pixels each. */
export function partsOf(width: number, height: number, across: number, down = across): Part[] {
  const parts: Part[] = [];
  for (let top = 0; top < height; top += down) {
    for (let left = 0; left < width; left += across) {
      parts.push({
        ...{ left, top },
        ...{ width: Math.min(across, width - left), height: Math.min(down, height - top) },
      });
    }
  }
  return parts;
}

/**
 * Return the parts to draw a picture in, with `samples` x `samples` samples to a pixel: whole rows as far as a texture of
 * `largestSide` texels goes, and one part where everything fits.
 */
export function tilesOf(width: number, height: number, samples: number, largestSide: number): Part[] {
  const side = Math.max(Math.floor(largestSide / samples), 1);
  const across = even(width, side);
  const most = Math.max(Math.floor(mostSamples / (across * samples ** 2)), 1);
  return partsOf(width, height, across, even(height, Math.min(side, most)));
}

/** Return a length of at most `most` by which another one is divided as evenly as possible: equal tiles share a target. */
function even(length: number, most: number): number {
  return Math.ceil(length / Math.ceil(length / most));
}

export function cameraOfPart(camera: ViewCamera, { left, top, width, height }: Part): ViewCamera {
  return { ...camera, width, height, centreX: camera.centreX - left, centreY: camera.centreY - top };
}

/** Return a column of the whole picture, a share of its width, as a share of a part's. */
export function shareIn(share: number, camera: ViewCamera, part: Part): number {
  return Math.min(Math.max((share * camera.width - part.left) / part.width, 0), 1);
}
