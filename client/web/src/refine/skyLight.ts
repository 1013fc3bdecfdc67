/** A prepared light as numbers for the processor: radiance by direction and roughness, turned and scaled. */

import { halfTable } from "../engine/half.js";
import type { PreparedLight } from "../light/prepare.js";
import type { Brightness } from "./lightSampler.js";
import { type Rotation, rotated, type Vector, vector } from "./vectors.js";

const halves = halfTable();

/** The same look-up as the shaders': bilinear in a level, linear in perceptual roughness between levels. */
export class SkyLight {
  readonly #inMap = vector();
  readonly #sharp = vector();
  readonly #rough = vector();

  /** `turn` takes directions of the map to the world. */
  constructor(
    readonly levels: PreparedLight["levels"],
    readonly turn: Rotation,
    readonly scale: number,
  ) {}

  /** Write the radiance from a direction of the world. */
  radiance(direction: Vector, out: Vector): void {
    rotated(this.turn, direction, this.#inMap, true);
    this.#level(0, out);
    for (let channel = 0; channel < 3; channel++) out[channel] = this.scale * out[channel]!;
  }

  /** Write the radiance through a lobe of a perceptual roughness. */
  prefiltered(direction: Vector, perceptualRoughness: number, out: Vector): void {
    rotated(this.turn, direction, this.#inMap, true);
    const last = this.levels.places.length - 1;
    const place = Math.min(Math.max(perceptualRoughness, 0), 1) * last;
    const index = Math.min(Math.floor(place), last - 1);
    this.#level(index, this.#sharp);
    this.#level(index + 1, this.#rough);
    for (let channel = 0; channel < 3; channel++) {
      const [sharp, rough] = [this.#sharp[channel]!, this.#rough[channel]!];
      out[channel] = this.scale * (sharp + (place - index) * (rough - sharp));
    }
  }

  #level(index: number, out: Vector): void {
    const [x, y, z] = [this.#inMap[0]!, this.#inMap[1]!, this.#inMap[2]!];
    const { halfRgba, width: stride } = this.levels;
    const [left0, top0, width, height] = this.levels.places[index]!;
    let u = 0.5 - Math.atan2(y, x) / (2 * Math.PI);
    u -= Math.floor(u);
    const v = Math.atan2(Math.sqrt(x * x + y * y), z) / Math.PI;
    const column = u * width - 0.5;
    const row = Math.min(Math.max(v * height - 0.5, 0), height - 1);
    const first = Math.floor(column);
    const top = Math.floor(row);
    const [across, down] = [column - first, row - top];
    const left = (first + width) % width;
    const right = (left + 1) % width;
    const bottom = Math.min(top + 1, height - 1);
    const at = (r: number, c: number): number => 4 * ((top0 + r) * stride + left0 + c);
    const [a, b, c, d] = [at(top, left), at(top, right), at(bottom, left), at(bottom, right)];
    for (let channel = 0; channel < 3; channel++) {
      const upper = halves[halfRgba[a + channel]!]! * (1 - across) + halves[halfRgba[b + channel]!]! * across;
      const lower = halves[halfRgba[c + channel]!]! * (1 - across) + halves[halfRgba[d + channel]!]! * across;
      out[channel] = upper * (1 - down) + lower * down;
    }
  }
}

/** Return the sum of a map's channels per pixel, rows from the top: the sharpest level. */
export function brightness({ halfRgba, width: stride, places }: PreparedLight["levels"]): Brightness {
  const [left, top, width, height] = places[0]!;
  const values = new Float64Array(width * height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const at = 4 * ((top + row) * stride + left + column);
      values[row * width + column] =
        halves[halfRgba[at]!]! + halves[halfRgba[at + 1]!]! + halves[halfRgba[at + 2]!]!;
    }
  }
  return { width, height, values };
}
