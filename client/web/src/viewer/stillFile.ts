/** Refined pictures of a viewer, in any size. */

import type { ViewCamera } from "../render/looks.js";
import { exrFrom, pngFrom } from "./save.js";
import type { Viewer } from "./viewer.js";
import { refinedStill, type StillOptions } from "../refine/still.js";

const samples = 2;

type Size = { readonly width: number; readonly height: number };

/** Return what a viewer shows, or what a camera would see, refined, as straight RGBA bytes, rows from the top. */
export async function refinedPixels(
  viewer: Viewer,
  size: Size | ViewCamera,
  options: StillOptions = {},
): Promise<Uint8ClampedArray<ArrayBuffer>> {
  const host = viewer.refineElsewhere();
  try {
    const camera = "cameraToWorld" in size ? size : viewer.camera(size.width, size.height);
    const into = new Uint8ClampedArray(4 * size.width * size.height);
    return await refinedStill(
      host,
      camera,
      into,
      (part, sides) => host.stage.readBytes(part, sides, samples),
      options,
    );
  } finally {
    host.end();
  }
}

/** Return a refined picture as a file. */
export async function refinedFile(
  viewer: Viewer,
  size: Size,
  kind: "png" | "exr",
  options: StillOptions = {},
): Promise<Blob> {
  const { width, height } = size;
  if (kind === "png") return pngFrom(await refinedPixels(viewer, size, options), width, height);
  const host = viewer.refineElsewhere();
  try {
    const into = new Uint16Array(4 * width * height);
    const read = (camera: Parameters<Viewer["pixelsOf"]>[0], sides: typeof host.sides) =>
      host.stage.readHalf(camera, sides, samples);
    return exrFrom(
      await refinedStill(host, viewer.camera(width, height), into, read, options),
      width,
      height,
    );
  } finally {
    host.end();
  }
}
