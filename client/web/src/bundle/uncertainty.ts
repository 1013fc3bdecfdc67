/** The grid of uncertainties, an NPY file of float16, as `lambent_relight.bundle.uncertainty` reads it. */

import type { Uncertainty } from "../contract/lambent_proto/v1/bundle_pb.js";
import { exportAgain, type BundleFault } from "../page/fault.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** One channel of the grid, x fastest. */
export type UncertaintyGrid = {
  readonly counts: readonly [x: number, y: number, z: number];
  readonly low: readonly number[];
  readonly high: readonly number[];
  /** Half floats, [z, y, x]: the relative standard deviation of albedo. */
  readonly albedoHalf: Uint16Array<ArrayBuffer>;
};

/** The mark of NPY files of version 1.0. */
const magic = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0];

function invalid(what: string): BundleFault {
  return exportAgain("bundle.uncertainty_invalid", fillIn(bundleFaults.uncertainty, { what }));
}

/** Return the channel "albedo" of the grid in `data`. */
export function readUncertainty(stated: Uncertainty, data: Uint8Array<ArrayBuffer>): UncertaintyGrid {
  if (!magic.every((byte, index) => data[index] === byte)) throw invalid(bundleFaults.notNpy);
  const start = 10 + (data[8]! | (data[9]! << 8));
  const text = new TextDecoder("latin1").decode(data.subarray(10, start));
  const shape = /'shape': \((\d+), (\d+), (\d+), (\d+)\)/.exec(text)?.slice(1).map(Number);
  const channel = stated.channels.indexOf("albedo");
  if (!text.includes("'<f2'") || !text.includes("'fortran_order': False") || shape === undefined) {
    throw invalid(bundleFaults.notGrid);
  }
  const [x, y, z, channels] = shape as [number, number, number, number];
  if (channels !== stated.channels.length || Math.min(x, y, z) < 1 || Math.max(x, y, z) > 256) {
    throw invalid(fillIn(bundleFaults.gridShape, { shape: shape.join(" x ") }));
  }
  if (channel < 0) throw invalid(bundleFaults.noAlbedo);
  if (data.length - start !== 2 * x * y * z * channels) throw invalid(bundleFaults.gridLength);
  const [low, high] = [stated.box?.minimum ?? [], stated.box?.maximum ?? []];
  if (low.length !== 3 || high.length !== 3 || !low.every((value, axis) => value < high[axis]!)) {
    throw invalid(bundleFaults.gridBox);
  }
  const values = new Uint16Array(data.slice(start).buffer);
  if (values.some((half) => (half & 0x7c00) === 0x7c00)) throw invalid(bundleFaults.gridNotFinite);
  const albedoHalf = new Uint16Array(x * y * z);
  for (let i = 0, from = channel; i < x; i++) {
    for (let j = 0; j < y; j++) {
      for (let k = 0; k < z; k++, from += channels) albedoHalf[(k * y + j) * x + i] = values[from]!;
    }
  }
  return { counts: [x, y, z], low, high, albedoHalf };
}
