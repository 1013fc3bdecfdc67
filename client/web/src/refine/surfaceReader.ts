/** Reads the surface at every sample of a picture back from the graphics card. */

import type { WebGLRenderTarget } from "three";
import type { ViewCamera } from "../render/looks.js";
import type { Stage } from "../render/stage.js";
import { cameraOfPart, tilesOf } from "../render/tiles.js";
import type { SurfaceSamples } from "./surfacePoints.js";

type Part = Pick<SurfaceSamples, "place" | "normal" | "distance" | "material">;

/** Samples that are read at once, 20 bytes each. */
const atOnce = 1 << 20;

/** Return the samples of what a camera sees that show the surface; what lies under `ground` is left out. */
export function readSamples(
  stage: Stage,
  camera: ViewCamera,
  samples: number,
  ground: boolean,
): SurfaceSamples {
  const { maxTextureSize } = stage.renderer.capabilities;
  const parts = tilesOf(camera.width, camera.height, samples, maxTextureSize).flatMap((tile) => {
    const target = stage.samples(cameraOfPart(camera, tile), samples, ground);
    const first = samples * (tile.top * samples * camera.width + tile.left);
    return readTarget(stage, target, first, samples * camera.width);
  });
  return { camera, samples, ...joined(parts) };
}

/** Return the samples of `target`, as `render/surface.ts` packs them; `first` is the place of its first one among `across` in a row. */
function readTarget({ renderer }: Stage, target: WebGLRenderTarget, first: number, across: number): Part[] {
  const gl = renderer.getContext() as WebGL2RenderingContext;
  const { width, height } = target;
  const strip = Math.max(1, Math.min(height, Math.floor(atOnce / width)));
  const words = new Uint32Array(4 * width * strip);
  const distances = new Float32Array(words.buffer);
  const facing = new Uint32Array(4 * width * strip);
  const parts: Part[] = [];
  renderer.setRenderTarget(target);
  // Rows of the picture run down, those of the card up.
  for (let top = 0; top < height; top += strip) {
    const rows = Math.min(strip, height - top);
    for (const [attachment, into] of [words, facing].entries()) {
      gl.readBuffer(gl.COLOR_ATTACHMENT0 + attachment);
      gl.readPixels(0, height - top - rows, width, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, into);
    }
    const [place, normal] = [new Uint32Array(width * rows), new Uint32Array(width * rows)];
    const distance = new Float32Array(width * rows);
    const material = new Uint32Array(2 * width * rows);
    let count = 0;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < width; column++) {
        const from = 4 * ((rows - 1 - row) * width + column);
        if (words[from + 1] === 0) continue;
        place[count] = first + (top + row) * across + column;
        normal[count] = facing[from]!;
        material.set(words.subarray(from + 2, from + 4), 2 * count);
        distance[count++] = distances[from + 1]!;
      }
    }
    parts.push({
      place: place.slice(0, count),
      normal: normal.slice(0, count),
      distance: distance.slice(0, count),
      material: material.slice(0, 2 * count),
    });
  }
  gl.readBuffer(gl.COLOR_ATTACHMENT0);
  renderer.setRenderTarget(null);
  return parts;
}

/** Return all parts as one. */
function joined(parts: readonly Part[]): Part {
  const count = parts.reduce((sum, part) => sum + part.place.length, 0);
  const all = {
    place: new Uint32Array(count),
    normal: new Uint32Array(count),
    distance: new Float32Array(count),
    material: new Uint32Array(2 * count),
  };
  let at = 0;
  for (const part of parts) {
    all.place.set(part.place, at);
    all.normal.set(part.normal, at);
    all.distance.set(part.distance, at);
    all.material.set(part.material, 2 * at);
    at += part.place.length;
  }
  return all;
}
