/** Reads which texel every sample of a picture shows back from the graphics card. */

import type { WebGLRenderer, WebGLRenderTarget } from "three";
import type { ViewCamera } from "../render/looks.js";
import type { SurfaceSamples } from "./surfacePoints.js";

/** Samples that are read at once, 16 bytes each. */
const atOnce = 1 << 20;

/**
 * Return the samples of `target` that show the surface; it holds texel + 1, the bits of the distance, and, where
 * it is `mapped`, the material.
 */
export function readSamples(
  renderer: WebGLRenderer,
  target: WebGLRenderTarget,
  camera: ViewCamera,
  samples: number,
  mapped: boolean,
): SurfaceSamples {
  const gl = renderer.getContext() as WebGL2RenderingContext;
  const [width, height] = [camera.width * samples, camera.height * samples];
  const strip = Math.max(1, Math.min(height, Math.floor(atOnce / width)));
  const words = new Uint32Array(4 * width * strip);
  const distances = new Float32Array(words.buffer);
  const parts: { place: Uint32Array; texel: Uint32Array; distance: Float32Array; material: Uint32Array }[] =
    [];
  renderer.setRenderTarget(target);
  // Rows of the picture run down, those of the card up.
  for (let top = 0; top < height; top += strip) {
    const rows = Math.min(strip, height - top);
    gl.readPixels(0, height - top - rows, width, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
    const [place, texel] = [new Uint32Array(width * rows), new Uint32Array(width * rows)];
    const distance = new Float32Array(width * rows);
    const material = new Uint32Array(mapped ? 2 * width * rows : 0);
    let count = 0;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < width; column++) {
        const from = 4 * ((rows - 1 - row) * width + column);
        if (words[from] === 0) continue;
        place[count] = (top + row) * width + column;
        texel[count] = words[from]! - 1;
        if (mapped) material.set(words.subarray(from + 2, from + 4), 2 * count);
        distance[count++] = distances[from + 1]!;
      }
    }
    parts.push({
      place: place.slice(0, count),
      texel: texel.slice(0, count),
      distance: distance.slice(0, count),
      material: material.slice(0, mapped ? 2 * count : 0),
    });
  }
  renderer.setRenderTarget(null);
  const count = parts.reduce((sum, part) => sum + part.place.length, 0);
  const all = {
    place: new Uint32Array(count),
    texel: new Uint32Array(count),
    distance: new Float32Array(count),
    material: mapped ? new Uint32Array(2 * count) : null,
  };
  let at = 0;
  for (const part of parts) {
    all.place.set(part.place, at);
    all.texel.set(part.texel, at);
    all.distance.set(part.distance, at);
    all.material?.set(part.material, 2 * at);
    at += part.place.length;
  }
  return { camera, samples, ...all };
}
