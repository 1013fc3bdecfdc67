/** Inspects and trims ONNX models before a runtime opens them. */

import { widenedHalves } from "./half.js";
import {
  encodedField,
  encodedNumber,
  joined,
  type WireField,
  wireBytes,
  wireFields,
  wireText,
} from "./onnxWire.js";

// Field numbers of onnx.proto, frozen by its compatibility rules.
const model = { graph: 7, metadata: 14 };
const graph = { node: 1, tensor: 5, output: 12 };
const node = { input: 1, output: 2, attribute: 5 };
const attributeGraphs = [6, 11];
const tensor = { dataType: 2, name: 8, externalData: 13 };
const float32 = 1;
const float16 = 10;

/** Values of a model that lie in the file of weights. */
export type WeightFile = {
  readonly model: Uint8Array<ArrayBuffer>;
  readonly weights: Uint8Array<ArrayBuffer>;
};

/** Return a model's metadata, by key. */
export function modelMetadata(data: Uint8Array): Record<string, string> {
  const found: Record<string, string> = {};
  for (const field of wireFields(data)) {
    if (field.number !== model.metadata) continue;
    const [key, value] = entryOf(wireBytes(field));
    found[key] = value;
  }
  return found;
}

/**
 * Return a model with only the graph outputs `names` and the nodes that serve them: runtimes compute every node,
 * asked for or not. Graphs with inner graphs keep all their nodes.
 */
export function keepOutputs(data: Uint8Array, names: readonly string[]): Uint8Array<ArrayBuffer> {
  return mapGraph(data, (parts) => {
    const kept = parts.filter((part) => part.number !== graph.output || names.includes(nameOf(part, 1)));
    if (kept.some((part) => part.number === graph.node && hasInnerGraph(part)))
      return kept.map((part) => part.raw);
    const needed = new Set(names);
    const serving: Uint8Array[] = [];
    // Nodes stand in an order in which none comes before what it needs.
    for (const part of kept.reverse()) {
      if (part.number === graph.node) {
        const inside = wireFields(wireBytes(part));
        if (!inside.some((field) => field.number === node.output && needed.has(wireText(field)))) continue;
        for (const field of inside) if (field.number === node.input) needed.add(wireText(field));
      }
      serving.push(part.raw);
    }
    return serving.reverse();
  });
}

/**
 * Return a model whose float16 tensors in the weight file are float32, and their values in a new file. For
 * runtimes whose hardware cannot compute with halves: the casts behind them then do nothing.
 */
export function withoutHalves(data: Uint8Array, weights: Uint8Array): WeightFile {
  const parts: Uint8Array[] = [];
  let size = 0;
  const place = (bytes: Uint8Array): number => {
    const offset = size + ((256 - (size % 256)) % 256);
    parts.push(new Uint8Array(offset - size), bytes);
    size = offset + bytes.length;
    return offset;
  };
  const changed = mapGraph(data, (fields) =>
    fields.map((part) => {
      if (part.number !== graph.tensor) return part.raw;
      const inside = wireFields(wireBytes(part));
      const entries = inside.filter((field) => field.number === tensor.externalData);
      if (entries.length === 0) return part.raw;
      const stated = Object.fromEntries(entries.map((field) => entryOf(wireBytes(field))));
      const [offset, length] = [Number(stated.offset ?? 0), Number(stated.length)];
      if (!(offset >= 0 && length >= 0 && offset + length <= weights.length)) {
        throw new RangeError(`the tensor ${nameOf(part, tensor.name)} does not lie inside the weights`);
      }
      const stored = weights.subarray(offset, offset + length);
      const half = inside.some((field) => field.number === tensor.dataType && field.value === float16);
      const values = half ? widenedHalves(stored) : stored;
      const rest = inside.filter((field) => ![tensor.externalData, tensor.dataType].includes(field.number));
      const kind = inside.find((field) => field.number === tensor.dataType)!;
      return encodedField(
        graph.tensor,
        joined([
          ...rest.map((field) => field.raw),
          half ? encodedNumber(tensor.dataType, float32) : kind.raw,
          ...entry("location", stated.location ?? ""),
          ...entry("offset", String(place(values))),
          ...entry("length", String(values.length)),
        ]),
      );
    }),
  );
  return { model: changed, weights: joined(parts) };
}

function entry(key: string, value: string): Uint8Array[] {
  return [encodedField(tensor.externalData, joined([encodedField(1, key), encodedField(2, value)]))];
}

function mapGraph(data: Uint8Array, change: (parts: WireField[]) => Uint8Array[]): Uint8Array<ArrayBuffer> {
  return joined(
    wireFields(data).map((field) =>
      field.number === model.graph
        ? encodedField(model.graph, joined(change(wireFields(wireBytes(field)))))
        : field.raw,
    ),
  );
}

function entryOf(data: Uint8Array): [string, string] {
  const fields = wireFields(data);
  const text = (number: number): string => {
    const found = fields.find((field) => field.number === number);
    return found === undefined ? "" : wireText(found);
  };
  return [text(1), text(2)];
}

function nameOf(message: WireField, number: number): string {
  const found = wireFields(wireBytes(message)).find((field) => field.number === number);
  return found === undefined ? "" : wireText(found);
}

function hasInnerGraph(message: WireField): boolean {
  return wireFields(wireBytes(message))
    .filter((field) => field.number === node.attribute)
    .some((field) => wireFields(wireBytes(field)).some((part) => attributeGraphs.includes(part.number)));
}
