/** Trims and widens ONNX models before a runtime opens them. */

import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import { OnnxEntrySchema, OnnxModelSchema } from "../contract/lambent_proto/v1/onnx_pb.js";
import { halfTable } from "./half.js";

const float32 = 1;
const float16 = 10;

/**
 * Return a model with only the graph outputs `names` and the nodes that serve them: runtimes compute every node,
 * asked for or not. Graphs with inner graphs keep all their nodes.
 */
export function keepOutputs(data: Uint8Array, names: readonly string[]): Uint8Array<ArrayBuffer> {
  const model = fromBinary(OnnxModelSchema, data);
  const graph = model.graph;
  if (graph !== undefined) {
    graph.output = graph.output.filter((output) => names.includes(output.name));
    const attributes = graph.node.flatMap((node) => node.attribute);
    if (!attributes.some((part) => part.g !== undefined || part.graphs.length > 0)) {
      const needed = new Set(names);
      // Nodes are sorted: none comes before what it needs.
      const serving = graph.node.reverse().filter((node) => {
        const serves = node.output.some((name) => needed.has(name));
        if (serves) for (const name of node.input) needed.add(name);
        return serves;
      });
      graph.node = serving.reverse();
    }
  }
  return toBinary(OnnxModelSchema, model);
}

/** Values of a model that lie in the file of weights. */
export type WeightFile = {
  readonly model: Uint8Array<ArrayBuffer>;
  readonly weights: Uint8Array<ArrayBuffer>;
};

/**
 * Return a model whose float16 tensors in the weight file are float32, and their values in a new file. For
 * runtimes whose hardware cannot compute with halves: the casts behind them then do nothing.
 */
export function withoutHalves(data: Uint8Array, weights: Uint8Array): WeightFile {
  const model = fromBinary(OnnxModelSchema, data);
  const parts: Uint8Array[] = [];
  let size = 0;
  for (const tensor of model.graph?.initializer ?? []) {
    if (tensor.externalData.length === 0) continue;
    const stated = Object.fromEntries(tensor.externalData.map(({ key, value }) => [key, value]));
    const [offset, length] = [Number(stated.offset ?? 0), Number(stated.length)];
    if (!(offset >= 0 && length >= 0 && offset + length <= weights.length)) {
      throw new RangeError(tensor.name); // It does not lie inside the weights.
    }
    const stored = weights.subarray(offset, offset + length);
    const values = tensor.dataType === float16 ? widenedHalves(stored) : stored;
    if (tensor.dataType === float16) tensor.dataType = float32;
    const start = size + ((256 - (size % 256)) % 256);
    parts.push(new Uint8Array(start - size), values);
    size = start + values.length;
    tensor.externalData = Object.entries({
      location: stated.location,
      offset: start,
      length: values.length,
    }).map(([key, value]) => create(OnnxEntrySchema, { key, value: String(value ?? "") }));
  }
  return { model: toBinary(OnnxModelSchema, model), weights: joined(parts) };
}

function joined(parts: readonly Uint8Array[]): Uint8Array<ArrayBuffer> {
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

/** Return the bytes of little-endian halves as those of little-endian float32 numbers. */
export function widenedHalves(bytes: Uint8Array): Uint8Array<ArrayBuffer> {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const values = halfTable();
  const wide = new DataView(new ArrayBuffer(bytes.byteLength * 2));
  for (let at = 0; at < bytes.byteLength; at += 2) {
    wide.setFloat32(2 * at, values[view.getUint16(at, true)]!, true);
  }
  return new Uint8Array(wide.buffer);
}
