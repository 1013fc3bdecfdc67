/**
 * A bundle's graphs run by onnxruntime-web. Answers equal those of onnxruntime on a processor within 1e-5.
 *
 * The runtime is given: a page that needs another kind does not carry that one.
 */

import type { InferenceSession, Tensor } from "onnxruntime-web";
import type * as runtimes from "onnxruntime-web/wasm";
import { keepOutputs } from "./onnxModel.js";

/** "wasm" runs on the processor, "webgpu" on the graphics hardware and nowhere else. */
export type Provider = "wasm" | "webgpu";

/** The parts of onnxruntime-web that are used here. */
export type Runtime = Pick<typeof runtimes, "env" | "InferenceSession" | "Tensor">;

/** Rows of numbers, [row, width] after each other. */
export type RowsOf = Readonly<Record<string, Float32Array>>;

export type GraphOptions = {
  readonly provider: Provider;
  /** Of the same provider. */
  readonly runtime: Runtime;
  /** Outputs to compute; all when left out. */
  readonly outputs?: readonly string[];
  /** Folder with onnxruntime's .wasm files, ending in "/"; without, where the packager put them. */
  readonly wasmFolder?: string;
};

export class OnnxGraph {
  constructor(
    private readonly session: InferenceSession,
    private readonly runtime: Runtime,
  ) {}

  /** Return outputs by name for inputs [row, width], which have the same number of rows. */
  async run(inputs: RowsOf, widths: Readonly<Record<string, number>>): Promise<Record<string, Float32Array>> {
    const feed: Record<string, Tensor> = {};
    for (const [name, values] of Object.entries(inputs)) {
      const width = widths[name] ?? 3;
      feed[name] = new this.runtime.Tensor("float32", values, [values.length / width, width]);
    }
    const found = await this.session.run(feed);
    const answers: Record<string, Float32Array> = {};
    for (const [name, tensor] of Object.entries(found)) {
      answers[name] = (await tensor.getData()) as Float32Array;
      tensor.dispose();
    }
    return answers;
  }
}

/**
 * Open a graph of a bundle; `weights` are the bytes of models/weights.bin. With "webgpu" a graph that would
 * need the CPU for any node is refused, so that it cannot be slow without notice. Throws what onnxruntime
 * throws.
 */
export async function openGraph(
  model: Uint8Array<ArrayBuffer>,
  weights: Uint8Array<ArrayBuffer>,
  options: GraphOptions,
): Promise<OnnxGraph> {
  const { runtime } = options;
  // Threads need a page that is isolated from other origins, which a viewer inside a page is not.
  runtime.env.wasm.numThreads = 1;
  if (options.wasmFolder !== undefined) runtime.env.wasm.wasmPaths = options.wasmFolder;
  const trimmed = options.outputs === undefined ? model : keepOutputs(model, options.outputs);
  const session = await runtime.InferenceSession.create(trimmed, {
    executionProviders: [options.provider],
    externalData: [{ path: "weights.bin", data: weights }],
    logSeverityLevel: 3,
    ...(options.provider === "webgpu" ? { extra: { session: { disable_cpu_ep_fallback: "1" } } } : {}),
  });
  return new OnnxGraph(session, runtime);
}
