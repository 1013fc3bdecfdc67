/** Shaders: put together from files of GLSL, and from macros for numbers that the rest knows too. */

import { tableWidth } from "../bundle/transport.js";
import { maxDominant } from "../light/prepare.js";
import constants from "../contract/constants.glsl?raw";
import reflectance from "../contract/reflectance.glsl?raw";
import { backgrounds, channels, outputs, toneCurves } from "./looks.js";
import header from "./shaders/header.glsl?raw";

export type Macros = Readonly<Record<string, number | string>>;

/** Return macros for the members of an enumeration: KIND_NAME. */
function named(kind: string, values: Readonly<Record<string, number>>): Macros {
  return Object.fromEntries(
    Object.entries(values).map(([name, value]) => [`${kind}_${name.toUpperCase()}`, value]),
  );
}

const common: Macros = {
  TABLE_WIDTH: tableWidth,
  MAX_DOMINANT: maxDominant,
  ...named("CHANNEL", channels),
  ...named("TONE", toneCurves),
  ...named("BACKGROUND", backgrounds),
  ...named("OUTPUT", outputs),
};

/** Return a shader of some parts, each of which may use the ones before. */
export function shader(parts: readonly string[], macros: Macros = {}): string {
  const lines = Object.entries({ ...common, ...macros }).map(([name, value]) => `#define ${name} ${value}\n`);
  return [header, constants, reflectance, ...lines, ...parts].join("");
}

/** Return a number as GLSL writes floats. */
export function float(value: number): string {
  const text = value.toPrecision(9);
  return /[.e]/.test(text) ? text : `${text}.0`;
}

/** Return statements that call `use(index, band, expression)` for every value of the basis at a unit vector x, y, z. */
export function basisStatements(
  bands: number,
  use: (index: number, band: number, value: string) => string,
): string {
  const lines = ["float wave0r = 1.0, wave0i = 0.0;"];
  let diagonal = Math.sqrt(0.25 / Math.PI);
  for (let m = 0; m < bands; m++) {
    if (m > 0) {
      diagonal *= Math.sqrt((2 * m + 1) / (2 * m));
      const [before, now] = [`wave${m - 1}`, `wave${m}`];
      lines.push(
        `float ${now}r = ${before}r * x - ${before}i * y, ${now}i = ${before}r * y + ${before}i * x;`,
      );
    }
    for (let l = m; l < bands; l++) {
      if (l === m) {
        lines.push(`float q${l}_${m} = ${float(diagonal * (m > 0 ? Math.SQRT2 : 1))};`);
      } else {
        const scale = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
        const before = scale * Math.sqrt(Math.max(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1), 0));
        const minus = l > m + 1 ? ` - ${float(before)} * q${l - 2}_${m}` : "";
        lines.push(`float q${l}_${m} = ${float(scale)} * z * q${l - 1}_${m}${minus};`);
      }
      lines.push(use(l * (l + 1) + m, l, `q${l}_${m} * wave${m}r`));
      if (m > 0) lines.push(use(l * (l + 1) - m, l, `q${l}_${m} * wave${m}i`));
    }
  }
  return lines.join(" ");
}
