/**
 * The tensors, layers and feature grids of a bundle's models/weights.bin, as the fused reader packs them for
 * graphics hardware. What shaders will index is checked here. The same as lambent_relight/fused/weights.py.
 */

import type { BundleManifest, Grid, GridLevel, TensorEntry } from "../contract/lambent_proto/v1/bundle_pb.js";
import { exportAgain } from "../page/fault.js";
import { halfValue } from "./half.js";
import { modelMetadata } from "./onnxModel.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** The bundle's networks are not those that the fused reader knows; the message says why. */
export class NotFused extends Error {
  override readonly name = "NotFused";
}

/** An affine layer: weight [numOut, numIn], bias [numOut]. */
export type Layer = {
  readonly weight: Float32Array;
  readonly bias: Float32Array;
  readonly numIn: number;
  readonly numOut: number;
};

/** A multi-resolution feature grid over [-halfExtent, halfExtent]^3 of contracted space. */
export type FeatureGrid = Readonly<Pick<Grid, "numFeatures" | "halfExtent">> & {
  /** Row = firstRow + (x + multiplierY y + multiplierZ z) mod numRows. */
  readonly levels: readonly Omit<GridLevel, "$typeName" | "$unknown">[];
  /** Little-endian float32 or float16 numbers [row, numFeatures], as they lie in the file. */
  readonly table: Uint8Array;
  readonly halves: boolean;
};

/** The named tensors of a bundle. */
export class FusedWeights {
  private readonly entries: ReadonlyMap<string, TensorEntry>;

  constructor(
    private readonly manifest: BundleManifest,
    private readonly data: Uint8Array,
  ) {
    this.entries = new Map(manifest.tensors.map((entry) => [entry.name, entry]));
  }

  /** Return whether there is a tensor of this name. */
  has(name: string): boolean {
    return this.entries.has(name);
  }

  /** Return a layer, or several with the same inputs as one, their outputs after each other. */
  layer(...names: readonly string[]): Layer {
    const parts = names.map((name) => this.single(name));
    const numIn = parts[0]!.numIn;
    if (parts.some((part) => part.numIn !== numIn))
      throw new NotFused(`${names.join()} have different inputs`);
    const numOut = parts.reduce((sum, part) => sum + part.numOut, 0);
    const weight = Float32Array.from(parts.flatMap((part) => [...part.weight]));
    return { weight, bias: Float32Array.from(parts.flatMap((part) => [...part.bias])), numIn, numOut };
  }

  /** Return the layers `name`.0, `name`.1, ... as far as they go. */
  layers(name: string): Layer[] {
    const found: Layer[] = [];
    while (this.entries.has(`${name}.${found.length}.weight`))
      found.push(this.layer(`${name}.${found.length}`));
    return found;
  }

  /** Return a feature grid; throws BundleFault where it names rows that are not there. */
  grid(name: string): FeatureGrid {
    const stated = this.manifest.grids.find((grid) => grid.name === name);
    if (stated === undefined) throw new NotFused(`there is no grid ${name}`);
    const { bytes, shape, halves } = this.bytesOf(stated.tensor);
    const rows = shape.length === 2 && shape[1] === stated.numFeatures ? shape[0]! : 0;
    const inside = stated.levels.every(
      (level) => level.resolution >= 2 && level.numRows >= 1 && level.firstRow + level.numRows <= rows,
    );
    // Rows are found in 32-bit numbers without a sign.
    const small = stated.levels.every(
      (level) => (level.resolution - 1) * (1 + level.multiplierY + level.multiplierZ) < 2 ** 32,
    );
    if (stated.levels.length === 0 || !inside || !small || !(stated.halfExtent > 0)) {
      throw exportAgain("bundle.grid_invalid", fillIn(bundleFaults.gridRows, { name }));
    }
    return { ...stated, table: bytes, halves };
  }

  private single(name: string): Layer {
    const [weight, bias] = [this.bytesOf(`${name}.weight`), this.bytesOf(`${name}.bias`)];
    const [numOut, numIn] = weight.shape;
    if (weight.shape.length !== 2 || bias.shape.length !== 1 || bias.shape[0] !== numOut) {
      throw new NotFused(`${name} is not an affine layer`);
    }
    return { weight: numbersOf(weight), bias: numbersOf(bias), numIn: numIn!, numOut: numOut! };
  }

  private bytesOf(name: string): { bytes: Uint8Array; shape: readonly number[]; halves: boolean } {
    const entry = this.entries.get(name);
    const itemSize = entry?.dtype === "float32" ? 4 : entry?.dtype === "float16" ? 2 : 0;
    if (entry === undefined || itemSize === 0)
      throw new NotFused(`there is no float32 or float16 tensor ${name}`);
    const size = entry.shape.reduce((product, length) => product * length, itemSize);
    const [offset, end] = [entry.offsetBytes, entry.offsetBytes + size];
    const aligned = Number.isInteger(offset) && offset >= 0 && offset % itemSize === 0;
    if (!aligned || size !== entry.sizeBytes || end > this.data.length) {
      throw exportAgain("bundle.tensor_invalid", fillIn(bundleFaults.tensorOutside, { name }));
    }
    return { bytes: this.data.subarray(offset, end), shape: entry.shape, halves: itemSize === 2 };
  }
}

function numbersOf(tensor: { bytes: Uint8Array; halves: boolean }): Float32Array {
  const view = new DataView(tensor.bytes.buffer, tensor.bytes.byteOffset, tensor.bytes.byteLength);
  const step = tensor.halves ? 2 : 4;
  return Float32Array.from({ length: view.byteLength / step }, (_, index) =>
    tensor.halves ? halfValue(view.getUint16(2 * index, true)) : view.getFloat32(4 * index, true),
  );
}

/** Return the constants of a graph's network; throws NotFused unless it is of this kind and has all `names`. */
export function networkConstants(
  model: Uint8Array,
  kind: string,
  names: readonly string[],
): Readonly<Record<string, number>> {
  let values: unknown;
  try {
    values = JSON.parse(modelMetadata(model)["lambent.network"] ?? "null");
  } catch {
    throw new NotFused("the graph's lambent.network cannot be read");
  }
  const known = typeof values === "object" && values !== null ? (values as Record<string, unknown>) : {};
  if (known.kind !== kind) throw new NotFused(`the graph's network is ${String(known.kind)}, not ${kind}`);
  for (const name of names) {
    if (typeof known[name] !== "number" || !Number.isFinite(known[name])) {
      throw new NotFused(`the graph's lambent.network has no number ${name}`);
    }
  }
  return known as Readonly<Record<string, number>>;
}

/**
 * Return the width behind `layers`, and before which of them the inputs join again (-1: nowhere); throws NotFused
 * when sizes do not fit each other.
 */
export function chained(
  layers: readonly Layer[],
  numInputs: number,
  maySkip = false,
): { width: number; skip: number } {
  let [width, skip] = [numInputs, -1];
  layers.forEach((layer, index) => {
    if (maySkip && index > 0 && skip < 0 && layer.numIn === width + numInputs) skip = index;
    else if (layer.numIn !== width)
      throw new NotFused(`a layer has ${layer.numIn} inputs, expected ${width}`);
    width = layer.numOut;
  });
  return { width, skip };
}
