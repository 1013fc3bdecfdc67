/**
 * The fast cache as one compute shader: a ray per invocation, all layers in registers. `fusedCache.ts` packs what
 * it reads. Constants and tensors are those of docs/reference/bundle-format.md (networks).
 */

import { gridFunction, literal, type PackedGrid } from "./fusedGridShader.js";

/** Invocations of a workgroup. */
export const groupSize = 64;

/** A layer whose weights lie in the shader's buffer of 4 x 4 blocks, padded with zeros. */
export type PackedLayer = {
  /** Inputs by the array they are in, in the order of the weight's columns. */
  readonly sources: readonly { readonly array: string; readonly numIn: number }[];
  readonly target: string;
  readonly numOut: number;
  /** First block of the weights. */
  readonly firstBlock: number;
  /** First vec4 of the bias. */
  readonly firstBias: number;
  readonly relu: boolean;
};

/** The network that the shader evaluates. */
export type CacheProgram = {
  readonly contractionRadius: number;
  readonly near: number;
  readonly far: number;
  readonly numFrequencies: number;
  readonly curvePower: number;
  readonly curvePremultiplier: number;
  readonly numSamples: number;
  readonly distanceGrid: PackedGrid;
  /** Layers from the grid's features ("a") to the code. */
  readonly code: readonly PackedLayer[];
  readonly codeWidth: number;
  readonly codeArray: string;
  /** Layers from "inputs" to the last activations, and the heads behind them, in "raw". */
  readonly network: readonly PackedLayer[];
  readonly head: PackedLayer;
  /** The part for the radiance; absent if it is not requested. */
  readonly radiance?: RadianceProgram;
  /** vec4 that the widest activations need. */
  readonly width: number;
};

/** The part of a fast cache for the radiance of the hit under a training light. */
export type RadianceProgram = {
  readonly grid: PackedGrid;
  /** Layers from the gathered features ("total") to the colour, in "raw". */
  readonly layers: readonly PackedLayer[];
  readonly colourBias: number;
};

/** Floats per ray that the shader writes: opacity, distance, and the radiance's three where it is wanted. */
export function answerWidth(program: CacheProgram): number {
  return program.radiance === undefined ? 2 : 5;
}

/** Return the shader's text; its entry point is `main`. */
export function cacheShader(program: CacheProgram): string {
  const { numSamples: count, radiance } = program;
  const layers = [...program.code, ...program.network, program.head, ...(radiance?.layers ?? [])];
  const names = new Map(layers.map((layer, index) => [layer, `layer_${index}`]));
  const call = (list: readonly PackedLayer[]): string =>
    list.map((layer) => `  ${names.get(layer)}();`).join("\n");
  const curve = curveOf(program);
  return `
@group(0) @binding(0) var<storage, read> tables: array<u32>;
@group(0) @binding(1) var<storage, read> blocks: array<mat4x4f>;
@group(0) @binding(2) var<storage, read> biases: array<vec4f>;
@group(0) @binding(3) var<storage, read> rays: array<f32>;
@group(0) @binding(4) var<storage, read_write> answers: array<f32>;
@group(0) @binding(5) var<uniform> num_rays: vec4u;

var<private> inputs: array<vec4f, ${program.width}>;
var<private> a: array<vec4f, ${program.width}>;
var<private> b: array<vec4f, ${program.width}>;
var<private> total: array<vec4f, ${program.width}>;
var<private> raw: array<vec4f, ${Math.ceil((3 * count + 1) / 4)}>;

${common(program.contractionRadius)}
${gridFunction("distance_features", program.distanceGrid, "a")}
${radiance === undefined ? "" : gridFunction("colour_features", radiance.grid, "a")}
${layers.map((layer) => layerFunction(names.get(layer)!, layer)).join("\n")}

@compute @workgroup_size(${groupSize})
fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= num_rays.x) { return; }
  let ray = 6u * id.x;
  let origin = vec3f(rays[ray], rays[ray + 1u], rays[ray + 2u]);
  let direction = vec3f(rays[ray + 3u], rays[ray + 4u], rays[ray + 5u]);
  let place = contracted(origin);
  distance_features(place);
${call(program.code)}
${copied(program.codeArray, "inputs", program.codeWidth)}
${encodedText("place", program.codeWidth, program.numFrequencies)}
${encodedText("direction", program.codeWidth + 3 + 6 * program.numFrequencies, program.numFrequencies)}
${call(program.network)}
${call([program.head])}
  var places: array<f32, ${count}>;
  var shares: array<f32, ${count}>;
  var largest = value_of(${2 * count}u);
  for (var k = 1u; k < ${count}u; k++) { largest = max(largest, value_of(${2 * count}u + k)); }
  var sum = 0.0;
  var moment = 0.0;
  for (var k = 0u; k < ${count}u; k++) {
    let gate = sigmoid(value_of(${count}u + k) - 2.0);
    let s = f32(k) / ${literal(count - 1)} + value_of(k) / ${literal(count)} * gate;
    let whole = floor(s);
    let rest = s - whole;
    let odd = whole - 2.0 * floor(whole * 0.5);
    let y = ${literal(curve.start)} + mix(rest, 1.0 - rest, odd) * ${literal(curve.end - curve.start)};
    let stretched = pow(${literal(curve.slope)} * y + 1.0, ${literal(1 / program.curvePower)});
    places[k] = (stretched - 1.0) * ${literal(curve.unit)};
    shares[k] = exp(value_of(${2 * count}u + k) - largest);
    sum += shares[k];
    moment += shares[k] * places[k];
  }
  let opacity = sigmoid(value_of(${3 * count}u) + 2.0);
  let answer = ${answerWidth(program)}u * id.x;
  answers[answer] = opacity;
  answers[answer + 1u] = select(moment / sum, ${literal(program.far)}, opacity < 1e-3);
${radiance === undefined ? "" : radianceText(radiance, count, call(radiance.layers))}
}
`;
}

function radianceText(radiance: RadianceProgram, count: number, layers: string): string {
  const width = Math.ceil((radiance.grid.levels.length * radiance.grid.numFeatures) / 4);
  return `
  for (var i = 0u; i < ${width}u; i++) { total[i] = vec4f(0.0); }
  for (var k = 0u; k < ${count}u; k++) {
    colour_features(contracted(origin + direction * places[k]));
    let share = shares[k] / sum * opacity;
    for (var i = 0u; i < ${width}u; i++) { total[i] += share * a[i]; }
  }
${layers}
  for (var c = 0u; c < 3u; c++) {
    let x = value_of(c) + ${literal(radiance.colourBias)};
    answers[answer + 2u + c] = opacity * (max(x, 0.0) + log(1.0 + exp(-abs(x))));
  }`;
}

/** Return the ladder of distances: t = unit ((slope y + 1)^(1 / power) - 1), y from start to end. */
function curveOf(program: CacheProgram): { start: number; end: number; slope: number; unit: number } {
  const { curvePower: power, curvePremultiplier: premultiplier } = program;
  const a = Math.abs(power - 1);
  const ladder = (t: number): number => (a / power) * (((premultiplier * t) / a + 1) ** power - 1);
  return { start: ladder(program.near), end: ladder(program.far), slope: power / a, unit: a / premultiplier };
}

function common(radius: number): string {
  return `
fn contracted(position: vec3f) -> vec3f {
  let scaled = position / ${literal(radius)};
  let size = max(length(scaled), 1.0);
  return scaled * ((2.0 - 1.0 / size) / size);
}

fn sigmoid(x: f32) -> f32 { return 1.0 / (1.0 + exp(-x)); }

fn value_of(index: u32) -> f32 { return raw[index / 4u][index % 4u]; }

// Sines (quarter 0) and cosines (quarter 1) within 1e-7: what hardware must offer is a thousand times coarser.
fn wave(angle: vec3f, quarter: i32) -> vec3f {
  let turns = round(angle * 0.63661977);
  let r = ((angle - turns * 1.5703125) - turns * 4.8375129699707e-4) - turns * 7.54978994876865e-8;
  let z = r * r;
  let sine = ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * r + r;
  let cosine = ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * z * z - 0.5 * z + 1.0;
  let q = vec3i(turns) + quarter;
  let value = select(sine, cosine, (q & vec3i(1)) == vec3i(1));
  return select(value, -value, (q & vec3i(2)) == vec3i(2));
}`;
}

/** Return the statements that put [v, sin 2^j v .., cos 2^j v ..] into `inputs` from element `first`. */
function encodedText(vector: string, first: number, numFrequencies: number): string {
  const lines = [storeVector(vector, first)];
  for (const [quarter, offset] of [
    [0, 3],
    [1, 3 + 3 * numFrequencies],
  ] as const) {
    for (let octave = 0; octave < numFrequencies; octave++) {
      const name = `${vector}_${quarter}_${octave}`;
      lines.push(`  let ${name} = wave(${vector} * ${literal(2 ** octave)}, ${quarter});`);
      lines.push(storeVector(name, first + offset + 3 * octave));
    }
  }
  return lines.join("\n");
}

function storeVector(name: string, first: number): string {
  return ["x", "y", "z"]
    .map((axis, index) => `  ${element("inputs", first + index)} = ${name}.${axis};`)
    .join("\n");
}

function copied(from: string, to: string, count: number): string {
  return Array.from({ length: count }, (_, i) => `  ${element(to, i)} = ${element(from, i)};`).join("\n");
}

/** Return element `index` of an array of vec4. */
export function element(array: string, index: number): string {
  return `${array}[${index >> 2}].${"xyzw"[index & 3]}`;
}

function layerFunction(name: string, layer: PackedLayer): string {
  const numOut = Math.ceil(layer.numOut / 4);
  const numIn = layer.sources.map((source) => Math.ceil(source.numIn / 4));
  const perRow = numIn.reduce((sum, n) => sum + n, 0);
  let before = 0;
  const sums = layer.sources.map((source, index) => {
    const text = `
    for (var i = 0u; i < ${numIn[index]}u; i++) { sum += blocks[row + ${before}u + i] * ${source.array}[i]; }`;
    before += numIn[index]!;
    return text;
  });
  return `
fn ${name}() {
  for (var o = 0u; o < ${numOut}u; o++) {
    var sum = biases[${layer.firstBias}u + o];
    let row = ${layer.firstBlock}u + o * ${perRow}u;${sums.join("")}
    ${layer.target}[o] = ${layer.relu ? "max(sum, vec4f(0.0))" : "sum"};
  }
}`;
}
