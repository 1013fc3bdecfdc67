/** The cameras of cameras.json: those the object was photographed from. */

import { exportAgain } from "../page/fault.js";
import { bundleFaults } from "../words/words.js";

/** A pinhole camera; axes x right, y up, looking along -z; pixels from the top left corner. */
export type PhotoCamera = {
  readonly name: string;
  readonly width: number;
  readonly height: number;
  readonly focalX: number;
  readonly focalY: number;
  readonly centreX: number;
  readonly centreY: number;
  /** Row-major 4 x 4. */
  readonly cameraToWorld: readonly number[];
};

/** Return the cameras of the text of a cameras.json; throws BundleFault where it is none. */
export function parseCameras(data: Uint8Array): PhotoCamera[] {
  const fault = exportAgain("bundle.manifest_invalid", bundleFaults.cameras);
  let entries: unknown;
  try {
    entries = (JSON.parse(new TextDecoder().decode(data)) as { cameras?: unknown }).cameras;
  } catch {
    throw fault;
  }
  if (!Array.isArray(entries)) throw fault;
  return entries.slice(0, 4096).map((entry: Record<string, unknown>) => {
    const number = (name: string): number => {
      const value = entry[name];
      if (typeof value !== "number" || !Number.isFinite(value)) throw fault;
      return value;
    };
    const pose = entry.camera_to_world;
    if (!Array.isArray(pose) || pose.length !== 16 || !pose.every(Number.isFinite)) throw fault;
    return {
      name: String(entry.name ?? ""),
      width: number("width"),
      height: number("height"),
      focalX: number("focal_x"),
      focalY: number("focal_y"),
      centreX: number("centre_x"),
      centreY: number("centre_y"),
      cameraToWorld: pose as number[],
    };
  });
}
