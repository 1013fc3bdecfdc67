/**
 * Real spherical harmonics, the same as `lambent_relight.environment.harmonics`.
 *
 * Orthonormal, no Condon-Shortley sign, index l (l + 1) + m. Coefficients are [bands^2, 3] in one array:
 * `coefficientsRgb[3 * index + channel]`. Source: docs/reference/conventions.md (spherical harmonics).
 */

import type { Direction } from "./environment.js";
import type { EnvironmentMap, Rgb } from "./environmentMap.js";
import { gaussLegendre } from "./lobes.js";

const gauss = gaussLegendre(8);

/** Return Q_lm(z) for l < bands and 0 <= m <= l, at [l * bands + m]; zero where m > l. */
function legendre(z: number, bands: number): Float64Array {
  const q = new Float64Array(bands * bands);
  let diagonal = Math.sqrt(0.25 / Math.PI);
  for (let m = 0; m < bands; m++) {
    if (m > 0) diagonal *= Math.sqrt((2 * m + 1) / (2 * m));
    q[m * bands + m] = diagonal;
    if (m + 1 < bands) q[(m + 1) * bands + m] = Math.sqrt(2 * m + 3) * z * diagonal;
    for (let l = m + 2; l < bands; l++) {
      const scale = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
      const before = Math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1));
      q[l * bands + m] = scale * (z * q[(l - 1) * bands + m]! - before * q[(l - 2) * bands + m]!);
    }
  }
  return q;
}

/** Return the values of the basis at a unit direction, bands^2 of them. */
export function basis([x, y, z]: Direction, bands: number): Float64Array {
  const q = legendre(z, bands);
  const values = new Float64Array(bands * bands);
  let [real, imaginary] = [1, 0];
  for (let m = 0; m < bands; m++) {
    for (let l = m; l < bands; l++) {
      const centre = l * (l + 1);
      const value = q[l * bands + m]!;
      if (m === 0) {
        values[centre] = value;
      } else {
        values[centre + m] = Math.SQRT2 * value * real;
        values[centre - m] = Math.SQRT2 * value * imaginary;
      }
    }
    [real, imaginary] = [real * x - imaginary * y, real * y + imaginary * x];
  }
  return values;
}

/** Return the coefficients of the bilinear interpolant of an unturned map, integrated over the sphere. */
export function project(map: EnvironmentMap, bands: number): Float64Array {
  const { height, width, radianceRgb } = map;
  const rows = rowIntegrals(height, bands);
  const waves = columnIntegrals(width, bands);
  const coefficientsRgb = new Float64Array(3 * bands * bands);
  for (let row = 0; row < height; row++) {
    for (let m = 0; m < bands; m++) {
      const wave = waves.subarray(2 * m * width, 2 * (m + 1) * width);
      const [cosines, sines] = rowWaves(radianceRgb, 3 * row * width, wave);
      for (let l = m; l < bands; l++) {
        const weight = (m === 0 ? 1 : Math.SQRT2) * rows[(row * bands + l) * bands + m]!;
        addScaled(coefficientsRgb, 3 * (l * (l + 1) + m), weight, cosines);
        if (m > 0) addScaled(coefficientsRgb, 3 * (l * (l + 1) - m), weight, sines);
      }
    }
  }
  return coefficientsRgb;
}

/** Return the sums of a row's pixels times the cosines and the sines of its columns. */
function rowWaves(radianceRgb: ArrayLike<number>, start: number, waves: Float64Array): [Rgb, Rgb] {
  let [redC, greenC, blueC, redS, greenS, blueS] = [0, 0, 0, 0, 0, 0];
  for (let at = 0, from = start; at < waves.length; at += 2, from += 3) {
    const cosine = waves[at]!;
    const sine = waves[at + 1]!;
    const red = radianceRgb[from]!;
    const green = radianceRgb[from + 1]!;
    const blue = radianceRgb[from + 2]!;
    redC += red * cosine;
    greenC += green * cosine;
    blueC += blue * cosine;
    redS += red * sine;
    greenS += green * sine;
    blueS += blue * sine;
  }
  return [
    [redC, greenC, blueC],
    [redS, greenS, blueS],
  ];
}

function addScaled(target: Float64Array, start: number, scale: number, values: readonly number[]): void {
  for (let channel = 0; channel < 3; channel++) {
    target[start + channel] = target[start + channel]! + scale * values[channel]!;
  }
}

/** Return (cosine, sine) of m azimuth times the integral of a column's hat, at 2 (m width + column). */
function columnIntegrals(width: number, bands: number): Float64Array {
  const waves = new Float64Array(2 * bands * width);
  for (let m = 0; m < bands; m++) {
    const half = (Math.PI * m) / width;
    const hat = ((2 * Math.PI) / width) * (m === 0 ? 1 : (Math.sin(half) / half) ** 2);
    for (let column = 0; column < width; column++) {
      const azimuth = Math.PI - (2 * Math.PI * (column + 0.5)) / width;
      waves[2 * (m * width + column)] = hat * Math.cos(m * azimuth);
      waves[2 * (m * width + column) + 1] = hat * Math.sin(m * azimuth);
    }
  }
  return waves;
}

/** Return the integral over the polar angle of every row's hat times Q_lm sin^(m+1), at [(row l) m]. */
function rowIntegrals(height: number, bands: number): Float64Array {
  const size = bands * bands;
  const result = new Float64Array(height * size);
  const half = (0.5 * Math.PI) / height;
  for (let halfRow = 0; halfRow < 2 * height; halfRow++) {
    gauss.nodes.forEach((node, index) => {
      const polar = half * (halfRow + 0.5 * (node + 1));
      const place = (polar / Math.PI) * height - 0.5;
      const row = Math.min(Math.max(Math.floor(place), 0), height - 1);
      const below = row === height - 1 ? 0 : Math.min(Math.max(place - row, 0), 1);
      const q = legendre(Math.cos(polar), bands);
      const measure = 0.5 * half * gauss.weights[index]!;
      for (let l = 0; l < bands; l++) {
        for (let m = 0; m <= l; m++) {
          const value = measure * q[l * bands + m]! * Math.sin(polar) ** (m + 1);
          const slot = row * size + l * bands + m;
          result[slot] = result[slot]! + value * (1 - below);
          if (below > 0) result[slot + size] = result[slot + size]! + value * below;
        }
      }
    });
  }
  return result;
}

/** Return the coefficients of the function turned by +degrees about +z. */
export function rotateZ(coefficientsRgb: ArrayLike<number>, bands: number, degrees: number): Float64Array {
  const result = Float64Array.from(coefficientsRgb);
  for (let l = 1; l < bands; l++) {
    for (let m = 1; m <= l; m++) {
      const cosine = Math.cos((m * degrees * Math.PI) / 180);
      const sine = Math.sin((m * degrees * Math.PI) / 180);
      for (let channel = 0; channel < 3; channel++) {
        const even = 3 * (l * (l + 1) + m) + channel;
        const odd = 3 * (l * (l + 1) - m) + channel;
        result[even] = cosine * coefficientsRgb[even]! - sine * coefficientsRgb[odd]!;
        result[odd] = sine * coefficientsRgb[even]! + cosine * coefficientsRgb[odd]!;
      }
    }
  }
  return result;
}

/** Rows of a rotation matrix. */
export type Matrix3 = readonly [Direction, Direction, Direction];

/**
 * Return the coefficients of the function turned by any rotation: f'(d) = f(transpose(matrix) d).
 *
 * The turned function is projected by a quadrature over the sphere that is exact for products of two such functions.
 */
export function rotate(coefficientsRgb: ArrayLike<number>, bands: number, matrix: Matrix3): Float64Array {
  const result = new Float64Array(3 * bands * bands);
  const { nodes, weights } = gaussLegendre(bands);
  nodes.forEach((z, row) => {
    const radius = Math.sqrt(1 - z * z);
    for (let column = 0; column < 2 * bands; column++) {
      const azimuth = (Math.PI * column) / bands;
      const point: Direction = [radius * Math.cos(azimuth), radius * Math.sin(azimuth), z];
      const value: Rgb = [0, 0, 0];
      basis(transposedTimes(matrix, point), bands).forEach((at, k) => {
        for (const channel of [0, 1, 2] as const) value[channel] += at * coefficientsRgb[3 * k + channel]!;
      });
      const weight = (weights[row]! * Math.PI) / bands;
      basis(point, bands).forEach((at, k) => {
        addScaled(result, 3 * k, weight * at, value);
      });
    }
  });
  return result;
}

function transposedTimes(matrix: Matrix3, point: Direction): Direction {
  const column = (c: 0 | 1 | 2): number =>
    matrix[0][c] * point[0] + matrix[1][c] * point[1] + matrix[2][c] * point[2];
  return [column(0), column(1), column(2)];
}

/** Return the factor per coefficient that turns radiance into irradiance. */
export function cosineFactors(bands: number): Float64Array {
  const factors = new Float64Array(bands * bands);
  for (let l = 0; l < bands; l++) factors.fill(cosineFactor(l), l * l, (l + 1) ** 2);
  return factors;
}

function cosineFactor(l: number): number {
  if (l === 1) return (2 * Math.PI) / 3;
  if (l % 2 === 1) return 0;
  // l! / (2^l (l/2)!^2), as a product that stays small.
  let ratio = 1;
  for (let k = 1; k <= l / 2; k++) ratio *= (2 * k - 1) / (2 * k);
  const sign = l % 4 === 0 ? -1 : 1;
  return (sign * 2 * Math.PI * ratio) / ((l + 2) * (l - 1));
}
