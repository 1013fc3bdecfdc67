/**
 * Irradiance under a light, drawn whenever the light changes or turns: into a table of every texel, and from there
 * into pictures like the atlas, its gutters filled, for filtering by the hardware.
 *
 * direct: E = sum_k direct_k l_k + dominant lights with shadow bits; indirect: per channel, over coarse texels, and
 * bilinear between those at every texel. The same sums as `lambent_relight.baked.light`.
 */

import { LinearFilter, type RawShaderMaterial, type Texture, type WebGLRenderTarget } from "three";
import { numShadowDirections, tableWidth } from "../bundle/transport.js";
import { bouncedCoefficients, type FallingLight, sumFactors } from "../engine/fallingLight.js";
import { shadowDirections, shadowWeights } from "../engine/shadows.js";
import { maxDominant } from "../light/prepare.js";
import { header, tables } from "./glsl.js";
import { type FullScreen, screenProgram, setUniforms } from "./fullScreen.js";
import { halfFloatTarget } from "./targets.js";
import type { BundleTextures } from "./textures.js";

const storedDirections = shadowDirections(numShadowDirections);

function planeSum(layers: number): string {
  return `
uniform isampler2DArray planes;
uniform vec4 red[${layers}];
uniform vec4 green[${layers}];
uniform vec4 blue[${layers}];
uniform vec3 base;
vec3 planeSum(ivec2 where) {
  vec3 sum = base;
  for (int layer = 0; layer < ${layers}; layer++) {
    vec4 q = vec4(texelFetch(planes, ivec3(where, layer), 0));
    sum += vec3(dot(q, red[layer]), dot(q, green[layer]), dot(q, blue[layer]));
  }
  return sum;
}
`;
}

/** Share of a dominant light at a texel: a weighted mean of its nearest shadow bits. */
const shadows = `
uniform isampler2DArray material;
uniform vec4 materialScales[2];
uniform vec4 materialOffsets[2];
uniform usampler2DArray shadowBits;
uniform int numLights;
uniform vec3 lightDirections[${maxDominant}];
uniform int neighbours[${6 * maxDominant}];
uniform float weights[${6 * maxDominant}];
vec4 only(int light) { return vec4(equal(ivec4(light), ivec4(0, 1, 2, 3))); }
vec3 normalAt(ivec2 where) {
  vec4 second = materialOffsets[1] + materialScales[1] * vec4(texelFetch(material, ivec3(where, 1), 0));
  return second.yzw / max(length(second.yzw), 1e-12);
}
float freeAt(ivec2 where, int light) {
  uvec4 low = texelFetch(shadowBits, ivec3(where, 0), 0);
  uvec4 high = texelFetch(shadowBits, ivec3(where, 1), 0);
  float free = 0.0;
  for (int n = 0; n < 6; n++) {
    int bit = neighbours[6 * light + n];
    uint word = (bit < 128 ? low : high)[(bit >> 5) & 3];
    free += weights[6 * light + n] * float((word >> uint(bit & 31)) & 1u);
  }
  return free;
}
`;

const lightSum = `
uniform sampler2D shares;
uniform vec3 lightIrradiance[${maxDominant}];
vec3 lightSum(ivec2 where) {
  vec3 normal = normalAt(where);
  vec4 share = texelFetch(shares, where, 0);
  vec3 sum = vec3(0.0);
  for (int light = 0; light < numLights; light++) {
    sum += max(dot(normal, lightDirections[light]), 0.0) * dot(share, only(light)) * lightIrradiance[light];
  }
  return sum;
}
`;

const shareProgram = `${header}${shadows}
out vec4 result;
void main() {
  ivec2 where = ivec2(gl_FragCoord.xy);
  vec3 normal = normalAt(where);
  result = vec4(0.0);
  for (int light = 0; light < numLights; light++) {
    if (dot(normal, lightDirections[light]) > 0.0) result += freeAt(where, light) * only(light);
  }
}`;

/** Sums of planes; the openness beside direct ones. */
function program(layers: number, kind: "direct" | "lit" | "indirect"): string {
  const lights = kind === "lit";
  const open =
    "clamp((constant.x + constant.y * float(texelFetch(planes, ivec3(where, 0), 0).r)) / (0.5 * sqrt(pi)), 0.0, 1.0)";
  return `${header}${planeSum(layers)}${lights ? shadows + lightSum : ""}
out vec4 result;
uniform vec2 constant;
void main() {
  ivec2 where = ivec2(gl_FragCoord.xy);
  result = vec4(planeSum(where)${lights ? " + lightSum(where)" : ""}, ${kind === "indirect" ? "1.0" : open});
}`;
}

/** From tables to the atlas: openness beside direct light, the factor to the surroundings' radiance beside indirect. */
const spreadProgram = (lights: boolean): string => `${header}${tables}
layout(location = 0) out vec4 straight;
layout(location = 1) out vec4 again;
${lights ? "layout(location = 2) out vec4 share;\nuniform sampler2D shares;" : ""}
uniform usampler2D texelPlane;
uniform usampler2D blocksAround;
uniform sampler2D direct;
uniform sampler2D indirect;
vec3 block(uint index) { return texelFetch(indirect, placeOf(index), 0).rgb; }
void main() {
  ivec2 where = placeOf(texelFetch(texelPlane, ivec2(gl_FragCoord.xy), 0).r);
  straight = texelFetch(direct, where, 0);
  uvec4 around = texelFetch(blocksAround, where, 0);
  again.rgb = 0.5625 * block(around.x) + 0.1875 * (block(around.y) + block(around.z)) + 0.0625 * block(around.w);
  again.a = 1.0 / (pi * max(1.0 - straight.a, 0.05));
  ${lights ? "share = texelFetch(shares, where, 0);" : ""}
}`;

/** Draws irradiance of one object. */
export class IrradiancePasses {
  readonly #direct: RawShaderMaterial;
  readonly #indirect: RawShaderMaterial;
  readonly #shares: RawShaderMaterial | null;
  readonly #spread: RawShaderMaterial;
  /** What every light is drawn into first. */
  readonly #tables: { readonly [name in "direct" | "indirect" | "shares"]: WebGLRenderTarget };

  constructor(private readonly textures: BundleTextures) {
    const { direct, indirect, material } = textures.transport;
    const lights = textures.shadowBits !== null;
    this.#tables = {
      direct: halfFloatTarget(tableWidth, direct.rows),
      indirect: halfFloatTarget(tableWidth, indirect.rows),
      shares: halfFloatTarget(tableWidth, lights ? direct.rows : 1),
    };
    this.#direct = screenProgram(program(direct.layers, lights ? "lit" : "direct"));
    this.#indirect = screenProgram(program(indirect.layers, "indirect"));
    this.#shares = lights ? screenProgram(shareProgram) : null;
    this.#spread = screenProgram(spreadProgram(lights));
    setUniforms(this.#direct, { planes: textures.direct, constant: [direct.offsets[0]!, direct.scales[0]!] });
    setUniforms(this.#indirect, { planes: textures.indirect });
    setUniforms(this.#spread, {
      texelPlane: textures.texelPlane,
      blocksAround: textures.blocksAround,
      direct: this.#tables.direct.texture,
      indirect: this.#tables.indirect.texture,
      shares: this.#tables.shares.texture,
    });
    for (const pass of this.programs) {
      const values = { material: textures.material, shadowBits: textures.shadowBits };
      setUniforms(pass, { ...values, materialScales: material.scales, materialOffsets: material.offsets });
    }
  }

  /** All programs. */
  get programs(): RawShaderMaterial[] {
    const shares = this.#shares === null ? [] : [this.#shares];
    return [this.#direct, this.#indirect, this.#spread, ...shares];
  }

  /** Draw all of a light. */
  draw(screen: FullScreen, light: FallingLight, into: AtlasLight): void {
    const { direct, indirect } = this.textures.transport;
    setUniforms(this.#direct, sumFactors(direct, light.coefficientsRgb, 1));
    if (this.#shares !== null) {
      const lights = lightUniforms(light);
      setUniforms(this.#shares, lights);
      screen.draw(this.#shares, this.#tables.shares);
      setUniforms(this.#direct, { ...lights, shares: this.#tables.shares.texture });
    }
    setUniforms(this.#indirect, sumFactors(indirect, bouncedCoefficients(light, indirect.bands), 3));
    screen.draw(this.#direct, this.#tables.direct);
    screen.draw(this.#indirect, this.#tables.indirect);
    screen.draw(this.#spread, into.target);
  }

  dispose(): void {
    for (const pass of this.programs) pass.dispose();
    for (const table of Object.values(this.#tables)) table.dispose();
  }
}

/** Irradiance under one light as pictures like the atlas, filtered. */
export class AtlasLight {
  readonly target: WebGLRenderTarget;

  constructor({ transport, shadowBits }: BundleTextures) {
    const count = shadowBits === null ? 2 : 3;
    this.target = halfFloatTarget(transport.size, transport.size, LinearFilter, count);
  }

  /** Direct irradiance, and the unoccluded share of the hemisphere. */
  get direct(): Texture {
    return this.target.textures[0]!;
  }

  /** Indirect irradiance, and the factor from it to the mean radiance of the surroundings. */
  get indirect(): Texture {
    return this.target.textures[1]!;
  }

  /** Share of each dominant light, one channel each; null where they have no shadows. */
  get shares(): Texture | null {
    return this.target.textures[2] ?? null;
  }

  dispose(): void {
    this.target.dispose();
  }
}

/** Return the uniforms of dominant lights and of their shadows. */
function lightUniforms(light: FallingLight) {
  const dominant = dominantUniforms(light);
  const neighbours = new Int32Array(6 * maxDominant);
  const weights = new Float32Array(6 * maxDominant);
  for (let index = 0; index < dominant.numLights; index++) {
    const near = shadowWeights(storedDirections, light.directions[index]!);
    neighbours.set(near.indices, 6 * index);
    weights.set(near.weights, 6 * index);
  }
  return { ...dominant, neighbours, weights };
}

/** Return number, directions and irradiance of dominant lights for a shader. */
export function dominantUniforms({
  directions,
  irradianceRgb,
}: Pick<FallingLight, "directions" | "irradianceRgb">) {
  const numLights = Math.min(directions.length, maxDominant);
  const lightDirections = new Float32Array(3 * maxDominant);
  const lightIrradiance = new Float32Array(3 * maxDominant);
  for (let index = 0; index < numLights; index++) {
    lightDirections.set(directions[index]!, 3 * index);
    lightIrradiance.set(irradianceRgb[index]!, 3 * index);
  }
  return { numLights, lightDirections, lightIrradiance };
}
