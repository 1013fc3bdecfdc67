/**
 * Irradiance of every texel under a light, drawn into small tables whenever the light changes or turns.
 *
 * direct: E = sum_k direct_k l_k + dominant lights with shadow bits; indirect: per channel, over coarse texels.
 * The same sums as `lambent_relight.baked.light`.
 */

import type { RawShaderMaterial, WebGLRenderTarget } from "three";
import { numShadowDirections, tableWidth } from "../bundle/transport.js";
import { bouncedCoefficients, type FallingLight, sumFactors } from "../engine/fallingLight.js";
import { shadowDirections, shadowWeights } from "../engine/shadows.js";
import { maxDominant } from "../light/prepare.js";
import { header } from "./glsl.js";
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

function program(layers: number, lights: boolean): string {
  return `${header}${planeSum(layers)}${lights ? shadows + lightSum : ""}
out vec4 result;
void main() {
  ivec2 where = ivec2(gl_FragCoord.xy);
  result = vec4(planeSum(where)${lights ? " + lightSum(where)" : ""}, 1.0);
}`;
}

/** Draws irradiance tables of one object. */
export class IrradiancePasses {
  readonly #direct: RawShaderMaterial;
  readonly #indirect: RawShaderMaterial;
  readonly #shares: RawShaderMaterial | null;

  constructor(private readonly textures: BundleTextures) {
    const { direct, indirect, material } = textures.transport;
    const lights = textures.shadowBits !== null;
    this.#direct = screenProgram(program(direct.layers, lights));
    this.#indirect = screenProgram(program(indirect.layers, false));
    this.#shares = lights ? screenProgram(shareProgram) : null;
    this.#direct.uniforms.planes!.value = textures.direct;
    this.#indirect.uniforms.planes!.value = textures.indirect;
    for (const pass of this.programs) {
      const values = { material: textures.material, shadowBits: textures.shadowBits };
      setUniforms(pass, { ...values, materialScales: material.scales, materialOffsets: material.offsets });
    }
  }

  /** All programs. */
  get programs(): RawShaderMaterial[] {
    return [this.#direct, this.#indirect, ...(this.#shares === null ? [] : [this.#shares])];
  }

  /** Draw all tables for a light. */
  draw(screen: FullScreen, light: FallingLight, into: IrradianceTables): void {
    const { direct, indirect } = this.textures.transport;
    setUniforms(this.#direct, sumFactors(direct, light.coefficientsRgb, 1));
    if (this.#shares !== null) {
      const lights = lightUniforms(light);
      setUniforms(this.#shares, lights);
      screen.draw(this.#shares, into.shares);
      setUniforms(this.#direct, { ...lights, shares: into.shares.texture });
    }
    setUniforms(this.#indirect, sumFactors(indirect, bouncedCoefficients(light, indirect.bands), 3));
    screen.draw(this.#direct, into.direct);
    screen.draw(this.#indirect, into.indirect);
  }

  dispose(): void {
    this.#direct.dispose();
    this.#indirect.dispose();
    this.#shares?.dispose();
  }
}

/** Irradiance of every texel under one light. */
export class IrradianceTables {
  readonly direct: WebGLRenderTarget;
  readonly indirect: WebGLRenderTarget;
  /** Share of each dominant light at every texel, one channel each. */
  readonly shares: WebGLRenderTarget;

  constructor(textures: BundleTextures) {
    const { rows } = textures.transport.direct;
    this.direct = halfFloatTarget(tableWidth, rows);
    this.indirect = halfFloatTarget(tableWidth, textures.transport.indirect.rows);
    this.shares = halfFloatTarget(tableWidth, textures.shadowBits === null ? 1 : rows);
  }

  dispose(): void {
    this.direct.dispose();
    this.indirect.dispose();
    this.shares.dispose();
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
