import { create, fromBinary, type MessageInitShape, toBinary } from "@bufbuild/protobuf";
import { describe, expect, it } from "vitest";
import { BundleManifestSchema } from "../src/contract/lambent_proto/v1/bundle_pb.js";
import { OnnxModelSchema } from "../src/contract/lambent_proto/v1/onnx_pb.js";
import { packFastCache } from "../src/engine/fusedCache.js";
import { gridFunction, literal } from "../src/engine/fusedGridShader.js";
import { cacheShader } from "../src/engine/fusedShader.js";
import { chained, FusedWeights, type Layer, NotFused, networkConstants } from "../src/engine/fusedWeights.js";
import { halfValue } from "../src/engine/half.js";
import { keepOutputs, modelMetadata } from "../src/engine/onnxModel.js";
import { widenedHalves, withoutHalves } from "./onnxWebgpu.js";

const model = (fields: MessageInitShape<typeof OnnxModelSchema>) =>
  toBinary(OnnxModelSchema, create(OnnxModelSchema, fields));
const graphOf = (data: Uint8Array) => fromBinary(OnnxModelSchema, data).graph!;
const network = (value: unknown) => ({ key: "lambent.network", value: JSON.stringify(value) });

/** Return a tensor in the weight file; kind 1 is float32, 10 float16. */
function external(name: string, kind: number, offset: number, length: number) {
  const places = Object.entries({ location: "weights.bin", offset, length });
  const externalData = places.map(([key, value]) => ({ key, value: String(value) }));
  return { name, dataType: kind, externalData, dataLocation: 1 };
}

const constants = {
  kind: "fast_cache.v1",
  contraction_radius: 1,
  near: 0.05,
  far: 2,
  num_frequencies: 1,
  curve_power: -1.5,
  curve_premultiplier: 2,
};
const twoOutputs = model({
  graph: {
    node: [
      { input: ["x"], output: ["y"] },
      { input: ["y"], output: ["z"] },
    ],
    output: [{ name: "y" }, { name: "z" }],
  },
  metadataProps: [network(constants)],
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
  it("tells its metadata", () => {
    expect(networkConstants(twoOutputs, "fast_cache.v1", ["near", "far"]).far).toBe(2);
    expect(Object.keys(modelMetadata(twoOutputs))).toEqual(["lambent.network"]);
  });

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
    expect(() => withoutHalves(outside, new Uint8Array(300))).toThrow(/table does not lie inside/);
    expect(() => keepOutputs(twoOutputs.subarray(0, 9), ["y"])).toThrow();
    expect(() => modelMetadata(Uint8Array.of(0x08, 0x80))).toThrow();
  });
});

/** A fast cache of the smallest size: one level of 2^3 rows, layers 2 -> 4 -> 7 outputs. */
function smallCache(change: (tensors: Map<string, number[]>) => void = () => {}) {
  const shapes = new Map<string, number[]>([
    ["fast.distance_grid.table", [8, 2]],
    ["fast.code.layers.0.weight", [4, 2]],
    ["fast.code.layers.0.bias", [4]],
    ["fast.distance_network.layers.0.weight", [5, 22]],
    ["fast.distance_network.layers.0.bias", [5]],
  ]);
  for (const [name, size] of [
    ["offset", 2],
    ["gate", 2],
    ["logit", 2],
    ["opacity", 1],
  ] as const) {
    shapes.set(`fast.${name}_head.weight`, [size, 5]).set(`fast.${name}_head.bias`, [size]);
  }
  change(shapes);
  let offsetBytes = 0;
  const tensors = [...shapes].map(([name, shape]) => {
    const sizeBytes = 4 * shape.reduce((a, b) => a * b, 1);
    offsetBytes += 256;
    return { name, shape, dtype: "float32", offsetBytes: offsetBytes - 256, sizeBytes };
  });
  const level = { resolution: 2, firstRow: 0, numRows: 8, multiplierY: 2, multiplierZ: 4 };
  const grid = {
    name: "fast.distance_grid",
    tensor: "fast.distance_grid.table",
    numFeatures: 2,
    halfExtent: 1,
  };
  const manifest = create(BundleManifestSchema, {
    tensors,
    grids: [{ ...grid, levels: [level] }],
  });
  return { manifest, weights: new Uint8Array(offsetBytes + 512) };
}

describe("the fused reader", () => {
  it("packs a cache whose sizes fit, padded to blocks of four", () => {
    const { manifest, weights } = smallCache();
    const packed = packFastCache(manifest, twoOutputs, weights);
    expect(packed.program.numSamples).toBe(2);
    // Code: 1 block; network: 2 rows of ceil(22 / 4) blocks; heads: 2 rows of 2 blocks.
    expect(packed.blocks).toHaveLength(16 * (1 + 2 * 6 + 2 * 2));
    expect(cacheShader(packed.program)).toContain("@compute @workgroup_size(64)");
  });

  it("says which network it does not know", () => {
    const { manifest, weights } = smallCache();
    const other = model({ metadataProps: [network({ kind: "fast_cache.v2" })] });
    expect(() => packFastCache(manifest, other, weights)).toThrow(/fast_cache.v2, not fast_cache.v1/);
    expect(() => packFastCache(manifest, new Uint8Array(0), weights)).toThrow(NotFused);
    const wider = smallCache((shapes) => shapes.set("fast.code.layers.0.weight", [4, 3]));
    expect(() => packFastCache(wider.manifest, twoOutputs, wider.weights)).toThrow(/3 inputs, expected 2/);
  });

  it("refuses rows and tensors that are not there", () => {
    const { manifest, weights } = smallCache();
    const short = weights.subarray(0, 40);
    expect(() => new FusedWeights(manifest, short).grid("fast.distance_grid")).toThrow(/does not lie inside/);
    manifest.grids[0]!.levels[0]!.numRows = 9;
    expect(() => new FusedWeights(manifest, weights).grid("fast.distance_grid")).toThrow(/names rows/);
  });

  it("finds where the inputs join again", () => {
    const layer = (numIn: number, numOut: number): Layer => {
      return { numIn, numOut, weight: new Float32Array(numIn * numOut), bias: new Float32Array(numOut) };
    };
    expect(chained([layer(3, 8), layer(11, 8), layer(8, 4)], 3, true)).toEqual({ width: 4, skip: 1 });
    expect(() => chained([layer(3, 8), layer(11, 8)], 3)).toThrow(NotFused);
  });

  it("writes numbers that are read back as the same float32", () => {
    for (const value of [0, 1, -2.5, 1e-12, 3e30, 0.1]) {
      expect(Number(literal(value).slice(4, -1))).toBe(Number(Math.fround(value).toString()));
      expect(literal(value)).toMatch(/[.e]/);
    }
    expect(() => literal(Number.NaN)).toThrow(RangeError);
  });

  it.each([
    [2, "unpack2x16float(tables[7u + (index + 0u) / 2u])"],
    [3, "[(index + 0u) % 2u]"],
  ])("reads halves of %i features from pairs", (numFeatures, text) => {
    const levels = [{ resolution: 4, firstRow: 0, numRows: 64, multiplierY: 4, multiplierZ: 16 }];
    const grid = { firstWord: 7, halves: true, numFeatures, halfExtent: 1, levels };
    expect(gridFunction("features", grid, "a")).toContain(text);
  });
});
