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
import { type FullScreen, screenProgram, setUniforms } from "./fullScreen.js";
import planeSum from "./shaders/planeSum.frag.glsl?raw";
import spread from "./shaders/spread.frag.glsl?raw";
import { halfFloatTarget } from "./targets.js";
import type { BundleTextures } from "./textures.js";

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
    this.#direct = screenProgram([planeSum], { LAYERS: direct.layers, IS_DIRECT: "true" });
    this.#indirect = screenProgram([planeSum], { LAYERS: indirect.layers, IS_DIRECT: "false" });
    this.#spread = screenProgram([spread]);
    setUniforms(this.#direct, { planes: textures.direct, constant: [direct.offsets[0]!, direct.scales[0]!] });
    setUniforms(this.#indirect, { planes: textures.indirect });
    setUniforms(this.#spread, {
      texelPlane: textures.texelPlane,
      blocksAround: textures.blocksAround,
      direct: this.#tables.direct.texture,
      indirect: this.#tables.indirect.texture,
    });
  }

  get programs(): RawShaderMaterial[] {
    return [this.#direct, this.#indirect, this.#spread];
  }

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
