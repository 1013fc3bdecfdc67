/** Inspects and trims ONNX models before a runtime opens them. */

import { fromBinary, toBinary } from "@bufbuild/protobuf";
import { OnnxModelSchema } from "../contract/lambent_proto/v1/onnx_pb.js";

/** Return a model's metadata, by key. */
export function modelMetadata(data: Uint8Array): Record<string, string> {
  const { metadataProps } = fromBinary(OnnxModelSchema, data);
  return Object.fromEntries(metadataProps.map(({ key, value }) => [key, value]));
}

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
      // Nodes stand in an order in which none comes before what it needs.
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
