/** Pieces of shaders that several passes share. */

import { tableWidth } from "../bundle/transport.js";
import { numLobeSteps } from "../engine/lobes.js";
import { tableSide } from "../engine/splitSum.js";
import { maxDominant, numLevels } from "../light/prepare.js";

export const header = `
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler3D;
precision highp sampler2DArray;
precision highp isampler2DArray;
precision highp usampler2DArray;
precision highp usampler2D;
const float pi = 3.141592653589793;
`;

/** A triangle that covers the picture; no attributes but `position`. */
export const coverVertex = `
in vec3 position;
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }
`;

/** The normal of `surface.ts` from its octahedral halves. */
export const unfolded = `
vec3 unfolded(uint halves) {
  vec2 at = unpackSnorm2x16(halves);
  float height = 1.0 - abs(at.x) - abs(at.y);
  vec2 away = vec2(at.x >= 0.0 ? 1.0 : -1.0, at.y >= 0.0 ? 1.0 : -1.0);
  return normalize(vec3(height >= 0.0 ? at : (1.0 - abs(at.yx)) * away, height));
}
`;

/**
 * The first sample of a pixel: where a border covers a part of it but not its middle, and there is one sample to a
 * pixel, a sample of the surface beside it.
 */
export const firstSample = `
ivec2 firstSample(usampler2D seen, ivec2 first, bool masked, float covered) {
  if (!masked || covered <= 0.0 || texelFetch(seen, first, 0).g != 0u) return first;
  ivec2 last = textureSize(seen, 0) - 1;
  for (int side = 0; side < 8; side++) {
    int around = side < 4 ? side : side + 1;
    ivec2 beside = clamp(first + ivec2(around % 3, around / 3) - 1, ivec2(0), last);
    if (texelFetch(seen, beside, 0).g != 0u) return beside;
  }
  return first;
}
`;

/** Position of a texel in a table. */
export const tables = `
ivec2 placeOf(uint texel) { return ivec2(int(texel) % ${tableWidth}, int(texel) / ${tableWidth}); }
`;

/** Radiance of an environment: bilinear in a level, linear in perceptual roughness between levels. */
export const environment = `
uniform sampler2D levels;
uniform ivec4 levelPlaces[${numLevels}];
uniform mat3 toMap;
uniform float lightScale;

vec3 levelAt(int index, vec3 d) {
  ivec4 place = levelPlaces[index];
  float u = 0.5 - atan(d.y, d.x) / (2.0 * pi);
  u -= floor(u);
  float v = atan(length(d.xy), d.z) / pi;
  float column = u * float(place.z) - 0.5;
  float row = clamp(v * float(place.w) - 0.5, 0.0, float(place.w - 1));
  int left = int(floor(column));
  int top = int(row);
  vec2 share = vec2(column - float(left), row - float(top));
  left = (left + place.z) % place.z;
  int right = (left + 1) % place.z;
  int bottom = min(top + 1, place.w - 1);
  vec3 upper = mix(texelFetch(levels, place.xy + ivec2(left, top), 0).rgb,
    texelFetch(levels, place.xy + ivec2(right, top), 0).rgb, share.x);
  vec3 lower = mix(texelFetch(levels, place.xy + ivec2(left, bottom), 0).rgb,
    texelFetch(levels, place.xy + ivec2(right, bottom), 0).rgb, share.x);
  return mix(upper, lower, share.y);
}

vec3 radianceFrom(vec3 direction, float roughness) {
  vec3 d = toMap * direction;
  float place = clamp(roughness, 0.0, 1.0) * ${(numLevels - 1).toFixed(1)};
  int index = min(int(place), ${numLevels - 2});
  return lightScale * mix(levelAt(index, d), levelAt(index + 1, d), place - float(index));
}
`;

/** (scale, bias) of specular reflectance. */
export const splitSum = `
uniform sampler2D splitSumTable;
vec2 splitSum(float cosine, float roughness) {
  float last = ${(tableSide - 1).toFixed(1)};
  vec2 place = vec2(clamp(roughness, 0.0, 1.0), sqrt(clamp(cosine, 0.0, 1.0))) * last;
  ivec2 corner = min(ivec2(place), ivec2(${tableSide - 2}));
  vec2 share = place - vec2(corner);
  vec2 upper = mix(texelFetch(splitSumTable, corner, 0).rg,
    texelFetch(splitSumTable, corner + ivec2(1, 0), 0).rg, share.x);
  vec2 lower = mix(texelFetch(splitSumTable, corner + ivec2(0, 1), 0).rg,
    texelFetch(splitSumTable, corner + ivec2(1, 1), 0).rg, share.x);
  return mix(upper, lower, share.y);
}
`;

/**
 * Dominant lights in the specular lobe, as `lambent_relight.baked.dominant_highlights`: taken out of prefiltered radiance, and
 * reflected one by one, each in its own shadow. A lobe much narrower than a light sees its extent.
 */
export const glints = `
uniform int numLights;
uniform vec3 lightDirections[${maxDominant}];
uniform vec3 lightIrradiance[${maxDominant}];
float lobeScale(float square) {
  float base = 0.5 * (1.0 + square), slope = 0.5 * (square - 1.0);
  float integral = abs(slope) < 5e-3 ? 0.5 : (log(square / base) + base / square - 1.0) / (slope * slope);
  return 1.0 / (2.0 * pi * integral);
}
vec3 glints(vec3 n, vec3 o, vec3 mirror, float alpha, vec3 f0, vec4 share, inout vec3 prefiltered) {
  float trust = clamp((alpha - 0.05) / 0.1, 0.0, 1.0);
  vec3 added = vec3(0.0);
  if (trust <= 0.0 || numLights == 0) return added;
  float square = alpha * alpha;
  float k = 0.5 * alpha;
  float scale = lobeScale(square);
  float shadowO = 1.0 / (max(dot(n, o), 1e-6) * (1.0 - k) + k);
  vec3 taken = vec3(0.0);
  for (int light = 0; light < numLights; light++) {
    vec3 l = lightDirections[light];
    float c = dot(mirror, l);
    if (c > 0.0) {
      float spread = 0.5 * (1.0 + c) * square + 0.5 * (1.0 - c);
      taken += scale * c / (spread * spread) * lightIrradiance[light];
    }
    float cosine = dot(n, l);
    float seen = dot(share, vec4(equal(ivec4(light), ivec4(0, 1, 2, 3))));
    if (cosine <= 0.0 || seen <= 0.0) continue;
    vec3 h = o + l;
    h /= max(length(h), 1e-6);
    float cosH = max(dot(n, h), 0.0);
    float spread = cosH * cosH * (square - 1.0) + 1.0;
    float density = square / (pi * max(spread * spread, 1e-20));
    float shadowI = cosine / (cosine * (1.0 - k) + k);
    vec3 fresnel = f0 + (1.0 - f0) * pow(1.0 - clamp(dot(o, h), 0.0, 1.0), 5.0);
    added += trust * seen * density * shadowI * shadowO * 0.25 * fresnel * lightIrradiance[light];
  }
  prefiltered -= trust * min(taken, prefiltered);
  return added;
}
`;

function number(value: number): string {
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
        lines.push(`float q${l}_${m} = ${number(diagonal * (m > 0 ? Math.SQRT2 : 1))};`);
      } else {
        const scale = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
        const before = scale * Math.sqrt(Math.max(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1), 0));
        const minus = l > m + 1 ? ` - ${number(before)} * q${l - 2}_${m}` : "";
        lines.push(`float q${l}_${m} = ${number(scale)} * z * q${l - 1}_${m}${minus};`);
      }
      lines.push(use(l * (l + 1) + m, l, `q${l}_${m} * wave${m}r`));
      if (m > 0) lines.push(use(l * (l + 1) - m, l, `q${l}_${m} * wave${m}i`));
    }
  }
  return lines.join("\n  ");
}

/** The free part of a specular lobe: harmonics of the sky's openness, smoothed by the lobe. */
export function freeShare(bands: number): string {
  const layers = Math.ceil((bands * bands) / 4);
  const tableRows = Math.ceil(bands / 4);
  const factor = (band: number): string => `lobe${band >> 2}[${band & 3}]`;
  const lobes = Array.from(
    { length: tableRows },
    (_, row) =>
      `vec4 lobe${row} = mix(texelFetch(lobeTable, ivec2(step, ${row}), 0), ` +
      `texelFetch(lobeTable, ivec2(step + 1, ${row}), 0), place - float(step));`,
  );
  const statements = basisStatements(
    bands,
    (index, band, value) => `total += ${factor(band)} * open[${index >> 2}][${index & 3}] * ${value};`,
  );
  return `
uniform sampler2DArray visibility;
uniform vec4 visibilityScales[${layers}];
uniform vec4 visibilityOffsets[${layers}];
uniform sampler2D lobeTable;
float freeShare(vec4 open[${layers}], vec3 r, float roughness) {
  float x = r.x, y = r.y, z = r.z;
  float place = clamp(roughness, 0.0, 1.0) * ${(numLobeSteps - 1).toFixed(1)};
  int step = min(int(place), ${numLobeSteps - 2});
  ${lobes.join("\n  ")}
  float total = 0.0;
  ${statements}
  return clamp(total, 0.0, 1.0);
}
`;
}
