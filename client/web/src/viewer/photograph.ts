/** What a photograph is compared with: the look that is like the photograph's. */

import type { Look, Rgb } from "../render/looks.js";

/** Largest mean distance of the edge's pixels from their mean, of 255, for one colour. */
const evenSteps = 4;

/** Return the colour, sRGB 0 to 1, of the outermost pixels of RGBA bytes where they have one; else null. */
export function edgeColour(rgba: ArrayLike<number>, width: number, height: number): Rgb | null {
  const edge: number[] = [];
  for (let row = 0; row < height; row++) {
    const whole = row === 0 || row === height - 1;
    for (let column = 0; column < width; column += whole || width === 1 ? 1 : width - 1) {
      edge.push(4 * (row * width + column));
    }
  }
  if (edge.length === 0) return null;
  const means = [0, 1, 2].map(
    (channel) => edge.reduce((sum, at) => sum + rgba[at + channel]!, 0) / edge.length,
  );
  const away = edge.reduce(
    (sum, at) => sum + means.reduce((part, mean, channel) => part + Math.abs(rgba[at + channel]! - mean), 0),
    0,
  );
  if (away / (3 * edge.length) > evenSteps) return null;
  return [means[0]! / 255, means[1]! / 255, means[2]! / 255];
}

/**
 * Return how the relit side looks beside a photograph: photographs in bundles are sRGB-encoded radiance without a tone
 * curve or exposure, over one colour or in front of what surrounded the object.
 */
export function besidePhotograph(look: Look, edge: Rgb | null): Look {
  const background: Partial<Look> =
    edge === null ? { background: "environment" } : { background: "colour", backgroundSrgb: edge };
  return { ...look, tone: "linear", autoExposure: false, ...background };
}

/** Return the colour of the edge of a picture that an image element has loaded, or null. */
export function edgeOf(image: HTMLImageElement): Rgb | null {
  const { naturalWidth: width, naturalHeight: height } = image;
  const context = new OffscreenCanvas(Math.max(width, 1), Math.max(height, 1)).getContext("2d");
  if (context === null || width === 0) return null;
  context.drawImage(image, 0, 0);
  return edgeColour(context.getImageData(0, 0, width, height).data, width, height);
}
