/**
 * Importance sampling of an environment together with a lobe of the surface: `lambent_relight.environment.light_sampling`.
 *
 * A table holds, for lobes about a grid of axes, the probability of every cell of the map in proportion to radiance
 * times lobe; inside a cell, pixels are drawn by their radiance and directions uniformly in solid angle. The density is
 * known exactly, so a coarse table increases variance but causes no bias. Lobe 0 is the clamped cosine about
 * the normal; lobe k > 0 is exp(sharpness (cos - 1)) about the mirror direction. All directions here are the
 * map's.
 */

import {
  samplerAxesSide,
  samplerCellColumns,
  samplerCellRows,
  samplerFloorShare,
  samplerMaxRows,
  sharpnessTimesAlphaSquared,
} from "../contract/constants.js";
import { directionOfUv } from "../engine/environment.js";
import { pixelSolidAngle } from "../engine/environmentMap.js";
import { grouped } from "./grouped.js";
import type { Vector } from "./vectors.js";

export const cosineLobe = 0;
const lobeAlphas = [1, 0.5, 0.25, 0.125] as const;

/** Non-negative numbers per pixel of a latitude-longitude map, rows from the top. */
export type Brightness = { readonly width: number; readonly height: number; readonly values: Float64Array };

/** Return the number of the lobe that fits a GGX width best. */
export function lobeOfAlpha(alpha: number): number {
  let lobe = 1;
  for (let index = 1; index < lobeAlphas.length; index++) {
    if (alpha < Math.sqrt(lobeAlphas[index]! * lobeAlphas[index - 1]!)) lobe++;
  }
  return lobe;
}

/** Return the row of the table for a lobe about an axis. */
export function tableRow(axis: Vector, lobe: number): number {
  const [x, y, z] = [axis[0]!, axis[1]!, axis[2]!];
  const size = Math.max(Math.abs(x) + Math.abs(y) + Math.abs(z), 1e-20);
  const [px, py] = [x / size, y / size];
  const fx = z < 0 ? (1 - Math.abs(py)) * (px < 0 ? -1 : 1) : px;
  const fy = z < 0 ? (1 - Math.abs(px)) * (py < 0 ? -1 : 1) : py;
  const bin = (value: number): number =>
    Math.min(Math.max(Math.floor((value + 1) * (samplerAxesSide / 2)), 0), samplerAxesSide - 1);
  return lobe * samplerAxesSide * samplerAxesSide + bin(fy) * samplerAxesSide + bin(fx);
}

function binAxis(bin: number): readonly [number, number, number] {
  const middle = (index: number): number => (index + 0.5) * (2 / samplerAxesSide) - 1;
  const [x, y] = [middle(bin % samplerAxesSide), middle(Math.floor(bin / samplerAxesSide))];
  const z = 1 - Math.abs(x) - Math.abs(y);
  const fx = z < 0 ? (1 - Math.abs(y)) * (x < 0 ? -1 : 1) : x;
  const fy = z < 0 ? (1 - Math.abs(x)) * (y < 0 ? -1 : 1) : y;
  const length = Math.hypot(fx, fy, z);
  return [fx / length, fy / length, z / length];
}

/** Draws directions in proportion to the environment's radiance times a lobe, nearly. */
export class LightSampler {
  readonly #width: number;
  readonly #height: number;
  readonly #numCells: number;
  /** Cell of every pixel. */
  readonly #cell: Uint16Array;
  /** Pixels by cell, and where each cell's begin. */
  readonly #order: Uint32Array;
  readonly #cellFirst: Uint32Array;
  /** Running sums of the pixels' masses in that order. */
  readonly #ends: Float64Array;
  /** Density of a pixel inside its cell, 1/sr. */
  readonly #inside: Float64Array;
  /** Running sums of the cells' probabilities, row after row. */
  readonly #cellEnds: Float64Array;
  /** Mean of the map under the lobe of every row. */
  readonly #means: Float64Array;

  constructor(given: Brightness) {
    const { width, height, values: mass } = pixelMasses(given);
    [this.#width, this.#height] = [width, height];
    const { cell, numCells } = cells(width, height);
    this.#cell = cell;
    this.#numCells = numCells;
    const cellMass = new Float64Array(numCells);
    cell.forEach((number, pixel) => {
      cellMass[number]! += mass[pixel]!;
    });
    ({ order: this.#order, first: this.#cellFirst } = grouped(cell, numCells));
    this.#ends = new Float64Array(mass.length);
    let sum = 0;
    this.#order.forEach((pixel, place) => {
      sum += mass[pixel]!;
      this.#ends[place] = sum;
    });
    this.#inside = mass.map((value, pixel) => {
      const solidAngle = pixelSolidAngle(Math.floor(pixel / width), height, width);
      return value / (Math.max(cellMass[cell[pixel]!]!, 1e-300) * solidAngle);
    });
    const directions = cellDirections(cell, width, height, numCells);
    ({ ends: this.#cellEnds, means: this.#means } = lobeTable(cellMass, directions));
  }

  /**
   * Return the mean of the map under the lobe of a row, nearly, 1/sr: radiance over its integral, 1 / (4 pi) where the
   * light is even.
   */
  mean(row: number): number {
    return this.#means[row]!;
  }

  /** Draw a direction for a row of the table. Nearby uniforms mostly give nearby directions. */
  sample(u1: number, u2: number, row: number, out: Vector): void {
    const start = row * this.#numCells;
    const cell = firstAbove(this.#cellEnds, start, start + this.#numCells - 1, u1) - start;
    const before = cell > 0 ? this.#cellEnds[start + cell - 1]! : 0;
    const probability = Math.max(this.#cellEnds[start + cell]! - before, 1e-30);
    const insideCell = Math.min(Math.max((u1 - before) / probability, 0), 1);

    const [first, last] = [this.#cellFirst[cell]!, this.#cellFirst[cell + 1]! - 1];
    const begin = first > 0 ? this.#ends[first - 1]! : 0;
    const place = firstAbove(this.#ends, first, last, begin + u2 * (this.#ends[last]! - begin));
    const pixelBegin = place > 0 ? this.#ends[place - 1]! : 0;
    const pixelMass = Math.max(this.#ends[place]! - pixelBegin, 1e-300);
    const target = begin + u2 * (this.#ends[last]! - begin);
    const insidePixel = Math.min(Math.max((target - pixelBegin) / pixelMass, 0), 1);

    const pixel = this.#order[place]!;
    const row0 = Math.floor(pixel / this.#width);
    const top = Math.cos((Math.PI * row0) / this.#height);
    const bottom = Math.cos((Math.PI * (row0 + 1)) / this.#height);
    const z = top + (bottom - top) * insideCell;
    const azimuth = Math.PI - ((2 * Math.PI) / this.#width) * ((pixel % this.#width) + insidePixel);
    const radius = Math.sqrt(Math.max(1 - z * z, 0));
    out[0] = radius * Math.cos(azimuth);
    out[1] = radius * Math.sin(azimuth);
    out[2] = z;
  }

  /** Return the pixel that a direction lies in. */
  pixelOf(direction: Vector): number {
    const [x, y, z] = [direction[0]!, direction[1]!, direction[2]!];
    const u = 0.5 - Math.atan2(y, x) / (2 * Math.PI);
    const v = Math.atan2(Math.sqrt(x * x + y * y), z) / Math.PI;
    const column = Math.floor((u - Math.floor(u)) * this.#width) % this.#width;
    const row = Math.min(Math.max(Math.floor(v * this.#height), 0), this.#height - 1);
    return row * this.#width + column;
  }

  /** Return the density of `sample` for a row of the table at directions in a pixel, 1/sr. */
  density(row: number, pixel: number): number {
    const cell = this.#cell[pixel]!;
    const at = row * this.#numCells + cell;
    return (this.#cellEnds[at]! - (cell > 0 ? this.#cellEnds[at - 1]! : 0)) * this.#inside[pixel]!;
  }
}

/** Return the first place in [first, last] whose rising value is above `wanted`, `last` where none is. */
function firstAbove(values: Float64Array, first: number, last: number, wanted: number): number {
  let [low, high] = [first, last];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle]! > wanted) high = middle;
    else low = middle + 1;
  }
  return low;
}

function commonDivisor(a: number, b: number): number {
  return b === 0 ? a : commonDivisor(b, a % b);
}

/**
 * Return brightness times solid angle of sampling pixels, at most 512 rows of them, with a sum of one.
 *
 * The mean of the bilinear interpolant over a pixel is taken: the centre alone would give a black pixel beside a bright
 * one probability zero, although the interpolated radiance there is not zero.
 */
export function pixelMasses({ width, height, values }: Brightness): Brightness {
  const wrapped = new Float64Array(values.length);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const at = (c: number): number => values[row * width + ((c + width) % width)]!;
      wrapped[row * width + column] = 0.75 * at(column) + 0.125 * (at(column - 1) + at(column + 1));
    }
  }
  let [rows, columns] = [Math.min(height, samplerMaxRows), Math.min(width, 2 * samplerMaxRows)];
  if (height % rows !== 0 || width % columns !== 0) {
    // Sampling pixels must be unions of pixels with equal angles, or their solid angles would be wrong.
    [rows, columns] = [commonDivisor(height, rows), commonDivisor(width, columns)];
    if (rows * columns < 2048) [rows, columns] = [height, width];
  }
  const mass = new Float64Array(rows * columns);
  let sum = 0;
  for (let row = 0; row < height; row++) {
    const solidAngle = pixelSolidAngle(row, height, width);
    const target = Math.floor((row * rows) / height) * columns;
    const line = (r: number): number => Math.min(Math.max(r, 0), height - 1) * width;
    const [here, above, below] = [row, row - 1, row + 1].map(line) as [number, number, number];
    for (let column = 0; column < width; column++) {
      const mean =
        0.75 * wrapped[here + column]! + 0.125 * (wrapped[above + column]! + wrapped[below + column]!);
      const at = target + Math.floor((column * columns) / width);
      mass[at] = mass[at]! + mean * solidAngle;
      sum += mean * solidAngle;
    }
  }
  if (sum > 0) return { width: columns, height: rows, values: mass.map((value) => value / sum) };
  const even = mass.map(
    (_, pixel) => pixelSolidAngle(Math.floor(pixel / columns), rows, columns) / (4 * Math.PI),
  );
  return { width: columns, height: rows, values: even };
}

/** Return the cell of every pixel; cells are numbered along a Z-shaped curve. */
function cells(width: number, height: number): { cell: Uint16Array; numCells: number } {
  const code = new Uint16Array(width * height);
  const seen = new Int32Array(1 << 12).fill(-1);
  for (let row = 0; row < height; row++) {
    const r = Math.floor((row * Math.min(samplerCellRows, height)) / height);
    for (let column = 0; column < width; column++) {
      const c = Math.floor((column * Math.min(samplerCellColumns, width)) / width);
      let value = 0;
      for (let bit = 0; bit < 6; bit++) {
        value |= (((r >> bit) & 1) << (2 * bit + 1)) | (((c >> bit) & 1) << (2 * bit));
      }
      code[row * width + column] = value;
      seen[value] = 0;
    }
  }
  let numCells = 0;
  seen.forEach((found, value) => {
    if (found === 0) seen[value] = numCells++;
  });
  return { cell: code.map((value) => seen[value]!), numCells };
}

/** Return the mean direction of every cell, shorter than 1 for wide cells. */
function cellDirections(cell: Uint16Array, width: number, height: number, numCells: number): Float64Array {
  const sums = new Float64Array(3 * numCells);
  const total = new Float64Array(numCells);
  for (let row = 0; row < height; row++) {
    const weight = pixelSolidAngle(row, height, width);
    for (let column = 0; column < width; column++) {
      const number = cell[row * width + column]!;
      const direction = directionOfUv([(column + 0.5) / width, (row + 0.5) / height]);
      total[number] = total[number]! + weight;
      for (const axis of [0, 1, 2] as const) {
        sums[3 * number + axis] = sums[3 * number + axis]! + weight * direction[axis];
      }
    }
  }
  return sums.map((value, index) => value / total[Math.floor(index / 3)]!);
}

/** Return running sums of the probability of every cell, and the mean of the map, for every lobe and axis. */
function lobeTable(cellMass: Float64Array, directions: Float64Array) {
  const [numCells, numAxes] = [cellMass.length, samplerAxesSide * samplerAxesSide];
  const table = new Float64Array((1 + lobeAlphas.length) * numAxes * numCells);
  const means = new Float64Array((1 + lobeAlphas.length) * numAxes);
  const values = new Float64Array(numCells);
  for (let lobe = 0; lobe <= lobeAlphas.length; lobe++) {
    const sharpness = lobe > 0 ? sharpnessTimesAlphaSquared / lobeAlphas[lobe - 1]! ** 2 : 0;
    // Integral of the lobe over the sphere.
    const size =
      lobe === cosineLobe ? Math.PI * 1.1 ** 2 : (2 * Math.PI * (1 - Math.exp(-2 * sharpness))) / sharpness;
    for (let bin = 0; bin < numAxes; bin++) {
      const [x, y, z] = binAxis(bin);
      let [mean, lit] = [0, 0];
      for (let number = 0; number < numCells; number++) {
        const at = 3 * number;
        const cosine = x * directions[at]! + y * directions[at + 1]! + z * directions[at + 2]!;
        const value = lobe === cosineLobe ? Math.max(cosine + 0.1, 0) : Math.exp(sharpness * (cosine - 1));
        values[number] = value;
        mean += value / numCells;
        lit += value * cellMass[number]!;
      }
      means[lobe * numAxes + bin] = lit / size;
      // A floor keeps every lit cell possible, whatever the axis' place inside its bin. The last term is for maps of a
      // few pixels, whose cells may all lie outside a narrow lobe.
      const floor = samplerFloorShare * mean + 1e-12;
      let sum = 0;
      for (let number = 0; number < numCells; number++) sum += cellMass[number]! * (values[number]! + floor);
      const start = (lobe * numAxes + bin) * numCells;
      let running = 0;
      for (let number = 0; number < numCells; number++) {
        running += (cellMass[number]! * (values[number]! + floor)) / sum;
        table[start + number] = running;
      }
      table[start + numCells - 1] = Math.max(running, 1);
    }
  }
  return { ends: table, means };
}
