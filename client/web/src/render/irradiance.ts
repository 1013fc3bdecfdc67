/**
 * Irradiance under a light, drawn whenever the light changes or turns: into a table of every texel, and from there
 * into pictures like the atlas, its gutters filled, for filtering by the hardware.
 *
 * direct: E = sum_k direct_k l_k, without the dominant lights; indirect: per channel, over coarse texels, and
 * bilinear between those at every texel. The same sums as `lambent_relight.baked.light`.
 */

import { LinearFilter, type RawShaderMaterial, type Texture, type WebGLRenderTarget } from "three";
import { tableWidth } from "../bundle/transport.js";
import { bouncedCoefficients, type FallingLight, sumFactors } from "../engine/fallingLight.js";
import { maxDominant } from "../light/prepare.js";
import { header, tables } from "./glsl.js";
import { type FullScreen, screenProgram, setUniforms } from "./fullScreen.js";
import { halfFloatTarget } from "./targets.js";
import type { BundleTextures } from "./textures.js";

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

/** Sums of planes; the openness beside direct ones. */
function program(layers: number, kind: "direct" | "indirect"): string {
  const open =
    "clamp((constant.x + constant.y * float(texelFetch(planes, ivec3(where, 0), 0).r)) / (0.5 * sqrt(pi)), 0.0, 1.0)";
  return `${header}${planeSum(layers)}
out vec4 result;
uniform vec2 constant;
void main() {
  ivec2 where = ivec2(gl_FragCoord.xy);
  result = vec4(planeSum(where), ${kind === "indirect" ? "1.0" : open});
}`;
}

/** From tables to the atlas: openness beside direct light, the factor to the surroundings' radiance beside indirect. */
const spreadProgram = `${header}${tables}
layout(location = 0) out vec4 straight;
layout(location = 1) out vec4 again;
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
}`;

/** Draws irradiance of one object. */
export class IrradiancePasses {
  readonly #direct: RawShaderMaterial;
  readonly #indirect: RawShaderMaterial;
  readonly #spread: RawShaderMaterial;
  /** What every light is drawn into first. */
  readonly #tables: { readonly [name in "direct" | "indirect"]: WebGLRenderTarget };

  constructor(private readonly textures: BundleTextures) {
    const { direct, indirect } = textures.transport;
    this.#tables = {
      direct: halfFloatTarget(tableWidth, direct.rows),
      indirect: halfFloatTarget(tableWidth, indirect.rows),
    };
    this.#direct = screenProgram(program(direct.layers, "direct"));
    this.#indirect = screenProgram(program(indirect.layers, "indirect"));
    this.#spread = screenProgram(spreadProgram);
    setUniforms(this.#direct, { planes: textures.direct, constant: [direct.offsets[0]!, direct.scales[0]!] });
    setUniforms(this.#indirect, { planes: textures.indirect });
    setUniforms(this.#spread, {
      texelPlane: textures.texelPlane,
      blocksAround: textures.blocksAround,
      direct: this.#tables.direct.texture,
      indirect: this.#tables.indirect.texture,
    });
  }

  /** All programs. */
  get programs(): RawShaderMaterial[] {
    return [this.#direct, this.#indirect, this.#spread];
  }

  /** Draw all of a light. */
  draw(screen: FullScreen, light: FallingLight, into: AtlasLight): void {
    const { direct, indirect } = this.textures.transport;
    setUniforms(this.#direct, sumFactors(direct, light.coefficientsRgb, 1));
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

  constructor({ transport }: BundleTextures) {
    this.target = halfFloatTarget(transport.size, transport.size, LinearFilter, 2);
  }

  /** Direct irradiance, and the unoccluded share of the hemisphere. */
  get direct(): Texture {
    return this.target.textures[0]!;
  }

  /** Indirect irradiance, and the factor from it to the mean radiance of the surroundings. */
  get indirect(): Texture {
    return this.target.textures[1]!;
  }

  dispose(): void {
    this.target.dispose();
  }
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
