/**
 * The fast cache on graphics hardware, from the same weights.bin as the graphs: opacity and distance of secondary
 * rays, and on request their radiance under a training light. Needs WebGPU. Results equal the graph's
 * within 1e-5. Source: supplement 2.1; docs/reference/bundle-format.md (networks).
 */

import type { BundleManifest } from "../contract/lambent_proto/v1/bundle_pb.js";
import {
  answerWidth,
  type CacheProgram,
  cacheShader,
  groupSize,
  type PackedLayer,
  type RadianceProgram,
} from "./fusedShader.js";
import type { PackedGrid } from "./fusedGridShader.js";
import {
  chained,
  type FeatureGrid,
  FusedWeights,
  type Layer,
  networkConstants,
  NotFused,
} from "./fusedWeights.js";

const constantNames = [
  "contraction_radius",
  "near",
  "far",
  "num_frequencies",
  "curve_power",
  "curve_premultiplier",
];
const colourBias = -2;
// Numbers of the WebGPU standard, which workers and pages know as GPUBufferUsage and GPUMapMode.
const usage = { mapRead: 1, copyFrom: 4, copyTo: 8, uniform: 64, storage: 128 } as const;
const mapRead = 1;

/** Hits of rays, [ray, 1] and [ray, 3]; distances in scene units. */
export type CacheAnswers = {
  readonly opacity: Float32Array;
  readonly distance: Float32Array;
  /** Linear, multiplied by opacity; null if it was not requested. */
  readonly radianceRgb: Float32Array | null;
};

/** A program and the buffers it reads. */
export type PackedCache = {
  readonly program: CacheProgram;
  readonly tables: Uint8Array<ArrayBuffer>;
  readonly blocks: Float32Array<ArrayBuffer>;
  readonly biases: Float32Array<ArrayBuffer>;
};

/**
 * Pack the fast cache of a bundle: `model` is its graph, `weights` models/weights.bin, `light` the training or
 * adapted light whose radiance is wanted ("": none), which must be the graph's. Throws NotFused when the bundle has another network.
 */
export function packFastCache(
  manifest: BundleManifest,
  model: Uint8Array,
  weights: Uint8Array,
  light = "",
): PackedCache {
  const constants = networkConstants(model, "fast_cache.v1", constantNames);
  const numFrequencies = constants.num_frequencies!;
  const [radius, power] = [constants.contraction_radius!, constants.curve_power!];
  if (!(radius > 0) || !(numFrequencies >= 0 && numFrequencies <= 16) || power === 1 || power === 0) {
    throw new NotFused("the fast cache's constants are out of range");
  }
  const tensors = new FusedWeights(manifest, weights);
  const packer = new Packer();
  const distanceGrid = packer.grid(tensors.grid("fast.distance_grid"));
  const code = tensors.layers("fast.code.layers");
  const { width: codeWidth } = chained(code, featuresOf(distanceGrid));
  const network = tensors.layers("fast.distance_network.layers");
  const numInputs = codeWidth + 6 + 12 * numFrequencies;
  const { width: last, skip } = chained(network, numInputs, true);
  const head = tensors.layer(...["offset", "gate", "logit", "opacity"].map((name) => `fast.${name}_head`));
  const numSamples = (head.numOut - 1) / 3;
  if (head.numIn !== last || !Number.isInteger(numSamples) || numSamples < 2) {
    throw new NotFused("the fast cache's heads have another shape");
  }
  const codeLayers = packer.chain(code, { array: "a", numIn: featuresOf(distanceGrid) });
  const start = { array: "inputs", numIn: numInputs };
  const networkLayers = packer.chain(network, start, skip);
  const headLayer = packer.layer(head, [networkLayers.at(-1) ?? start].map(asSource), "raw", false);
  const radiance =
    light === "" ? undefined : packRadiance(tensors, packer, light, constants.colour_bias ?? colourBias);
  const program: CacheProgram = {
    contractionRadius: radius,
    near: constants.near!,
    far: constants.far!,
    numFrequencies,
    curvePower: power,
    curvePremultiplier: constants.curve_premultiplier!,
    numSamples,
    distanceGrid,
    code: codeLayers,
    codeWidth,
    codeArray: codeLayers.at(-1)?.target ?? "a",
    network: networkLayers,
    head: headLayer,
    width: Math.ceil(packer.widest / 4),
    ...(radiance === undefined ? {} : { radiance }),
  };
  return { program, ...packer.buffers() };
}

function packRadiance(tensors: FusedWeights, packer: Packer, light: string, bias: number): RadianceProgram {
  // A cache that was adapted to a light has its own radiance.
  const adapted = `adapted.${light}`;
  const own = tensors.has(`${adapted}.decoder_head.weight`);
  const prefix = own ? adapted : "fast";
  const grid = packer.grid(tensors.grid(`${prefix}.feature_grid`));
  const decoder = tensors.layers(`${prefix}.decoder`);
  const head = tensors.layer(own ? `${adapted}.decoder_head` : `fast.decoder_head.${light}`);
  const { width } = chained(decoder, featuresOf(grid));
  if (head.numIn !== width || head.numOut !== 3)
    throw new NotFused("the fast cache's colour has another shape");
  const start = { array: "total", numIn: featuresOf(grid) };
  const layers = packer.chain(decoder, start);
  const colour = packer.layer(head, [layers.at(-1) ?? start].map(asSource), "raw", false);
  return { grid, layers: [...layers, colour], colourBias: bias };
}

function asSource(from: PackedLayer | Source): Source {
  return "target" in from ? { array: from.target, numIn: from.numOut } : from;
}

function featuresOf(grid: PackedGrid): number {
  return grid.levels.length * grid.numFeatures;
}

type Source = { readonly array: string; readonly numIn: number };

/** Lays tensors out as the shader reads them. */
class Packer {
  widest = 4;
  private readonly tables: Uint8Array[] = [];
  private readonly blocks: number[] = [];
  private readonly biases: number[] = [];
  private numWords = 0;

  grid({ table, ...grid }: FeatureGrid): PackedGrid {
    const firstWord = this.numWords;
    const padded = new Uint8Array(Math.ceil(table.length / 4) * 4);
    padded.set(table);
    this.tables.push(padded);
    this.numWords += padded.length / 4;
    this.widest = Math.max(this.widest, grid.levels.length * grid.numFeatures);
    return { ...grid, firstWord };
  }

  /** Pack layers behind each other, in turn from array "a" to "b" and back; inputs join again before `skip`. */
  chain(layers: readonly Layer[], start: Source, skip = -1): PackedLayer[] {
    let from = start;
    return layers.map((layer, index) => {
      const target = from.array === "a" ? "b" : "a";
      const packed = this.layer(layer, index === skip ? [from, start] : [from], target, true);
      from = { array: target, numIn: layer.numOut };
      return packed;
    });
  }

  layer(layer: Layer, sources: readonly Source[], target: string, relu: boolean): PackedLayer {
    const [firstBlock, firstBias] = [this.blocks.length / 16, this.biases.length / 4];
    this.widest = Math.max(this.widest, layer.numOut, ...sources.map((source) => source.numIn));
    const at = (row: number, column: number): number =>
      row < layer.numOut ? layer.weight[row * layer.numIn + column]! : 0;
    for (let out = 0; out < layer.numOut; out += 4) {
      let before = 0;
      for (const source of sources) {
        for (let first = 0; first < source.numIn; first += 4) {
          // Columns of a 4 x 4 matrix follow each other.
          for (let column = first; column < first + 4; column++) {
            for (let row = out; row < out + 4; row++) {
              this.blocks.push(column < source.numIn ? at(row, before + column) : 0);
            }
          }
        }
        before += source.numIn;
      }
      for (let row = out; row < out + 4; row++) this.biases.push(layer.bias[row] ?? 0);
    }
    return { sources, target, numOut: layer.numOut, firstBlock, firstBias, relu };
  }

  buffers(): Pick<PackedCache, "tables" | "blocks" | "biases"> {
    const tables = new Uint8Array(4 * this.numWords);
    let place = 0;
    for (const part of this.tables) {
      tables.set(part, place);
      place += part.length;
    }
    return { tables, blocks: Float32Array.from(this.blocks), biases: Float32Array.from(this.biases) };
  }
}

/** The fast cache of one bundle on one device. */
export class FusedCache {
  private constructor(
    private readonly device: GPUDevice,
    private readonly pipeline: GPUComputePipeline,
    private readonly stored: readonly GPUBuffer[],
    /** Floats per ray of the answers: opacity, distance, and radiance where the cache was packed with it. */
    readonly answerWidth: number,
  ) {}

  /** Compile `packed` for a device; throws where the shader is refused. */
  static async create(device: GPUDevice, packed: PackedCache): Promise<FusedCache> {
    const module = device.createShaderModule({ code: cacheShader(packed.program) });
    const pipeline = await device.createComputePipelineAsync({
      layout: "auto",
      compute: { module, entryPoint: "main" },
    });
    const stored = [packed.tables, packed.blocks, packed.biases].map((data) => {
      const buffer = device.createBuffer({ size: data.byteLength, usage: usage.storage | usage.copyTo });
      device.queue.writeBuffer(buffer, 0, data);
      return buffer;
    });
    return new FusedCache(device, pipeline, stored, answerWidth(packed.program));
  }

  /** Return the hits of rays [ray, 6]: origin and unit direction each; at most 65535 x 64 rays. */
  async run(rays: Float32Array<ArrayBuffer>): Promise<CacheAnswers> {
    const count = rays.length / 6;
    const answerBytes = 4 * this.answerWidth * count;
    const make = (size: number, flags: number): GPUBuffer => this.device.createBuffer({ size, usage: flags });
    const asked = make(rays.byteLength, usage.storage | usage.copyTo);
    const answered = make(answerBytes, usage.storage | usage.copyFrom);
    const read = make(answerBytes, usage.mapRead | usage.copyTo);
    const size = make(16, usage.uniform | usage.copyTo);
    this.device.queue.writeBuffer(asked, 0, rays);
    this.device.queue.writeBuffer(size, 0, Uint32Array.of(count, 0, 0, 0));
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.pipeline);
    const buffers = [...this.stored, asked, answered, size];
    const entries = buffers.map((buffer, binding) => ({ binding, resource: { buffer } }));
    const layout = this.pipeline.getBindGroupLayout(0);
    pass.setBindGroup(0, this.device.createBindGroup({ layout, entries }));
    pass.dispatchWorkgroups(Math.ceil(count / groupSize));
    pass.end();
    encoder.copyBufferToBuffer(answered, 0, read, 0, answerBytes);
    this.device.queue.submit([encoder.finish()]);
    await read.mapAsync(mapRead);
    const values = new Float32Array(read.getMappedRange().slice(0));
    for (const buffer of [asked, answered, size, read]) buffer.destroy();
    const columns = (first: number, number: number): Float32Array =>
      Float32Array.from({ length: count * number }, (_, i) => {
        return values[Math.floor(i / number) * this.answerWidth + first + (i % number)]!;
      });
    return {
      opacity: columns(0, 1),
      distance: columns(1, 1),
      radianceRgb: this.answerWidth === 5 ? columns(2, 3) : null,
    };
  }
}
