/** Looking feature grids up in a shader; formula in docs/reference/bundle-format.md (feature grids). */

import type { FeatureGrid } from "./fusedWeights.js";

/** A feature grid whose table lies in the shader's buffer `tables`; with `halves` two features share a word. */
export type PackedGrid = Omit<FeatureGrid, "table"> & {
  /** First 32-bit word of the table. */
  readonly firstWord: number;
};

type Chunk = { readonly first: number; readonly size: 1 | 2 | 4 };

const types = { 1: "f32", 2: "vec2f", 4: "vec4f" } as const;

/** Return a number as WGSL writes it, so that it is read back as the same float32. */
export function literal(value: number): string {
  const rounded = Math.fround(value);
  if (!Number.isFinite(rounded)) throw new RangeError(`${value} is no number a shader can have`);
  const text = rounded.toString();
  return `f32(${/[.e]/.test(text) ? text : `${text}.0`})`;
}

/** Return functions of which `name`(contracted point) writes the features to the vec4 array `target`. */
export function gridFunction(name: string, grid: PackedGrid, target: string): string {
  const chunks = chunksOf(grid.numFeatures);
  const parts = chunks.map((chunk, index) => chunkFunctions(`${name}_${index}`, grid, chunk));
  const levels = grid.levels.map((level, index) => {
    const { resolution: n, firstRow, numRows, multiplierY, multiplierZ } = level;
    const scale = n / (2 * grid.halfExtent);
    const stores = chunks.map((chunk, c) => {
      const found = `${name}_${c}_at(rows, f)`;
      return `    let v${c} = ${found};\n${stored(target, index * grid.numFeatures + chunk.first, `v${c}`, chunk.size)}`;
    });
    return `  {
    let u = clamp(point * ${literal(scale)} + ${literal((n - 1) / 2)}, vec3f(0.0), vec3f(${literal(n - 1)}));
    let cell = min(floor(u), vec3f(${literal(n - 2)}));
    let f = u - cell;
    let c = vec3u(cell);
    let base = c.x + ${multiplierY}u * c.y + ${multiplierZ}u * c.z;
    var rows: array<u32, 8>;
${corners(multiplierY, multiplierZ, numRows, firstRow)}
${stores.join("\n")}
  }`;
  });
  return `${parts.join("\n")}
fn ${name}(point: vec3f) {
${padding(target, grid)}${levels.join("\n")}
}`;
}

function corners(multiplierY: number, multiplierZ: number, numRows: number, firstRow: number): string {
  const lines: string[] = [];
  for (let corner = 0; corner < 8; corner++) {
    const offset = (corner & 1) + ((corner >> 1) & 1) * multiplierY + (corner >> 2) * multiplierZ;
    lines.push(`    rows[${corner}] = ${firstRow}u + (base + ${offset}u) % ${numRows}u;`);
  }
  return lines.join("\n");
}

/** Return the statements that clear what the last vec4 holds beyond the features. */
function padding(target: string, grid: PackedGrid): string {
  const count = grid.levels.length * grid.numFeatures;
  return count % 4 === 0 ? "" : `  ${target}[${count >> 2}] = vec4f(0.0);\n`;
}

function chunksOf(numFeatures: number): Chunk[] {
  const chunks: Chunk[] = [];
  for (let first = 0; first < numFeatures; ) {
    const left = numFeatures - first;
    const size = left >= 4 ? 4 : left >= 2 ? 2 : 1;
    chunks.push({ first, size });
    first += size;
  }
  return chunks;
}

function chunkFunctions(name: string, grid: PackedGrid, chunk: Chunk): string {
  const type = types[chunk.size];
  return `
fn ${name}_row(row: u32) -> ${type} {
  let index = row * ${grid.numFeatures}u + ${chunk.first}u;
  ${fetch(grid, chunk)}
}

fn ${name}_at(rows: array<u32, 8>, f: vec3f) -> ${type} {
  let x00 = ${lerp(`${name}_row(rows[0])`, `${name}_row(rows[1])`, "f.x")};
  let x10 = ${lerp(`${name}_row(rows[2])`, `${name}_row(rows[3])`, "f.x")};
  let x01 = ${lerp(`${name}_row(rows[4])`, `${name}_row(rows[5])`, "f.x")};
  let x11 = ${lerp(`${name}_row(rows[6])`, `${name}_row(rows[7])`, "f.x")};
  return ${lerp(lerp("x00", "x10", "f.y"), lerp("x01", "x11", "f.y"), "f.z")};
}`;
}

function lerp(a: string, b: string, f: string): string {
  return `mix(${a}, ${b}, ${f})`;
}

function fetch(grid: PackedGrid, { size, first }: Chunk): string {
  const word = `${grid.firstWord}u + index`;
  if (!grid.halves) {
    const parts = Array.from({ length: size }, (_, i) => `bitcast<f32>(tables[${word} + ${i}u])`);
    return `return ${types[size]}(${parts.join(", ")});`;
  }
  const pair = (i: number): string => `unpack2x16float(tables[${grid.firstWord}u + (index + ${i}u) / 2u])`;
  if (grid.numFeatures % 2 === 0 && first % 2 === 0) {
    return size === 4
      ? `return vec4f(${pair(0)}, ${pair(2)});`
      : size === 2
        ? `return ${pair(0)};`
        : `return ${pair(0)}.x;`;
  }
  const parts = Array.from({ length: size }, (_, i) => `${pair(i)}[(index + ${i}u) % 2u]`);
  return `return ${types[size]}(${parts.join(", ")});`;
}

function stored(target: string, first: number, value: string, size: 1 | 2 | 4): string {
  if (size === 4 && first % 4 === 0) return `    ${target}[${first / 4}] = ${value};`;
  return Array.from({ length: size }, (_, i) => {
    const part = size === 1 ? value : `${value}.${"xyzw"[i]}`;
    return `    ${target}[${(first + i) >> 2}].${"xyzw"[(first + i) & 3]} = ${part};`;
  }).join("\n");
}
