import { create, fromBinary, type MessageInitShape, toBinary } from "@bufbuild/protobuf";
import { describe, expect, it } from "vitest";
import { OnnxModelSchema } from "../src/contract/lambent_proto/v1/onnx_pb.js";
import { halfValue } from "../src/engine/half.js";
import { keepOutputs, widenedHalves, withoutHalves } from "../src/engine/onnxModel.js";

const model = (fields: MessageInitShape<typeof OnnxModelSchema>) =>
  toBinary(OnnxModelSchema, create(OnnxModelSchema, fields));
const graphOf = (data: Uint8Array) => fromBinary(OnnxModelSchema, data).graph!;

/** Return a tensor in the weight file; kind 1 is float32, 10 float16. */
function external(name: string, kind: number, offset: number, length: number) {
  const places = Object.entries({ location: "weights.bin", offset, length });
  const externalData = places.map(([key, value]) => ({ key, value: String(value) }));
  return { name, dataType: kind, externalData, dataLocation: 1 };
}

const twoOutputs = model({
  graph: {
    node: [
      { input: ["x"], output: ["y"] },
      { input: ["y"], output: ["z"] },
    ],
    output: [{ name: "y" }, { name: "z" }],
  },
});

describe("half-precision numbers", () => {
  it("have the values of the standard", () => {
    const known = [0x0000, 0x0001, 0x03ff, 0x0400, 0x3c00, 0x3555, 0xc000, 0x7bff];
    expect(known.map(halfValue)).toEqual([
      0,
      2 ** -24,
      1023 * 2 ** -24,
      2 ** -14,
      1,
      0.333251953125,
      -2,
      65504,
    ]);
    expect(halfValue(0xfc00)).toBe(Number.NEGATIVE_INFINITY);
    expect(halfValue(0x7e00)).toBeNaN();
  });

  it("are widened wherever they lie in a file", () => {
    const file = Uint8Array.of(9, 0x00, 0x3c, 0x00, 0xc0);
    expect(new Float32Array(widenedHalves(file.subarray(1)).buffer)).toEqual(Float32Array.of(1, -2));
  });
});

describe("an ONNX model", () => {
  it("keeps the outputs that are asked for and what serves them, and nothing else", () => {
    const kept = graphOf(keepOutputs(twoOutputs, ["y"]));
    expect(kept.node).toHaveLength(1);
    expect(kept.output.map((output) => output.name)).toEqual(["y"]);
    expect(keepOutputs(twoOutputs, ["y", "z"])).toEqual(twoOutputs);
    expect(graphOf(keepOutputs(twoOutputs, ["z"])).node).toHaveLength(2);
  });

  it("keeps fields that we do not know, such as a node's operator", () => {
    const relu = Uint8Array.of(0x22, 4, ...new TextEncoder().encode("Relu"), 0x12, 1, 0x79);
    const one = Uint8Array.of(0x3a, relu.length + 2, 0x0a, relu.length, ...relu);
    expect(String.fromCharCode(...keepOutputs(one, ["y"]))).toContain("Relu");
  });

  it("loses its halves and keeps every value, at multiples of 256 bytes", () => {
    const weights = new Uint8Array(300);
    new DataView(weights.buffer).setFloat32(0, 0.1, true);
    weights.set([0x00, 0x3c, 0x00, 0xc0], 256);
    const initializer = [external("bias", 1, 0, 4), external("table", 10, 256, 4)];
    const wide = withoutHalves(model({ graph: { initializer } }), weights);
    const tensors = graphOf(wide.model).initializer.map(({ dataType, externalData }) => {
      const stated = Object.fromEntries(externalData.map(({ key, value }) => [key, value]));
      const view = new DataView(wide.weights.buffer, Number(stated.offset), Number(stated.length));
      const values = Array.from({ length: view.byteLength / 4 }, (_, i) => view.getFloat32(4 * i, true));
      return {
        kind: dataType,
        location: stated.location,
        aligned: Number(stated.offset) % 256 === 0,
        values,
      };
    });
    expect(tensors).toEqual([
      { kind: 1, location: "weights.bin", aligned: true, values: [Math.fround(0.1)] },
      { kind: 1, location: "weights.bin", aligned: true, values: [1, -2] },
    ]);
  });

  it("is refused where its tensors or its own bytes end too early", () => {
    const outside = model({ graph: { initializer: [external("table", 10, 256, 100)] } });
    expect(() => withoutHalves(outside, new Uint8Array(300))).toThrow("table");
    expect(() => keepOutputs(twoOutputs.subarray(0, 9), ["y"])).toThrow();
  });
});
