/**
 * Radiance of secondary rays' hit points, from baked transport: `lambent_relight.baked.hits`. All bounces are
 * included: the diffuse part comes from the irradiance of the nearest texel, the specular part from the split
 * sum.
 */

import { leastBlocked, numLobeSteps } from "../contract/constants.js";
import { baseReflectance } from "../contract/reflectance.js";
import type { AtlasMesh } from "../bundle/mesh.js";
import { type HitTransport, tableWidth } from "../bundle/transport.js";
import { basis } from "../engine/harmonics.js";
import { ggxBands } from "../engine/lobes.js";
import { splitSum, splitSumTable } from "../engine/splitSum.js";
import type { FallingLight } from "../engine/fallingLight.js";
import { bouncedIrradiance, directIrradiance } from "./litTexels.js";
import { NearestPoint } from "./nearestPoint.js";
import type { SkyLight } from "./skyLight.js";
import { edited, type RefineEdit, type TexelMaterials, texelMaterials } from "./surfacePoints.js";
import { texelPositions } from "./texelPositions.js";
import { type Vector, vector } from "./vectors.js";

/** The light-independent data of hits. */
export class HitScene {
  readonly materials: TexelMaterials;
  readonly lobes: Float32Array;
  readonly table = splitSumTable();
  /** Factor from indirect irradiance to the mean radiance of what stands around, per texel. */
  readonly surroundings: Float32Array;

  #nearest: NearestPoint | null = null;

  constructor(
    readonly transport: HitTransport,
    private readonly mesh: AtlasMesh,
  ) {
    this.materials = texelMaterials(transport);
    this.lobes = ggxBands(transport.visibility.bands);
    const { steps, scales, offsets } = transport.direct;
    this.surroundings = Float32Array.from({ length: transport.numTexels }, (_, texel) => {
      const constant = offsets[0]! + scales[0]! * steps[4 * texel]!;
      const open = Math.min(Math.max(constant / (0.5 * Math.sqrt(Math.PI)), 0), 1);
      return 1 / (Math.PI * Math.max(1 - open, leastBlocked));
    });
  }

  /** Prepared where a tracer does not know what it met. */
  get nearest(): NearestPoint {
    this.#nearest ??= new NearestPoint(texelPositions(this.mesh, this.transport));
    return this.#nearest;
  }
}

/** The radiance of hit points under one light. */
export class Hits {
  readonly #materials: TexelMaterials;
  /** Diffuse radiance, and mean radiance around, per texel. */
  readonly #diffuse: Float32Array;
  readonly #around: Float32Array;
  readonly #mirror = vector();
  readonly #sky = vector();

  constructor(
    private readonly scene: HitScene,
    private readonly light: SkyLight,
    falling: FallingLight,
    edit: RefineEdit,
  ) {
    const { transport, surroundings } = scene;
    this.#materials = edited(scene.materials, edit);
    const gain = edit.albedoGain.map((value, channel) => value * edit.albedoScaleRgb[channel]!);
    const bounced = bouncedIrradiance(transport, falling, gain);
    const straight = directIrradiance(transport, this.#materials.normal, falling);
    const { albedo, metalness } = this.#materials;
    this.#diffuse = straight.map((value, index) => {
      const metal = metalness[Math.floor(index / 3)]!;
      return ((1 - metal) * albedo[index]! * (value + bounced[index]!)) / Math.PI;
    });
    this.#around = bounced.map((value, index) => value * surroundings[Math.floor(index / 3)]!);
  }

  /** Return the texel nearest to (x, y, z). */
  texelAt(x: number, y: number, z: number): number {
    return this.scene.nearest.at(x, y, z);
  }

  /** Write the radiance of a texel towards `omegaO`. */
  radiance(texel: number, omegaO: Vector, out: Vector): void {
    const { normal, albedo, metalness, perceptualRoughness } = this.#materials;
    let cosine = 0;
    for (let axis = 0; axis < 3; axis++) cosine += normal[3 * texel + axis]! * omegaO[axis]!;
    for (let channel = 0; channel < 3; channel++) out[channel] = this.#diffuse[3 * texel + channel]!;
    if (cosine <= 0) return;
    for (let axis = 0; axis < 3; axis++) {
      this.#mirror[axis] = 2 * cosine * normal[3 * texel + axis]! - omegaO[axis]!;
    }
    const roughness = perceptualRoughness[texel]!;
    const { scale, bias } = splitSum(this.scene.table, cosine, roughness);
    const free = this.#freeShare(texel, roughness);
    this.light.prefiltered(this.#mirror, roughness, this.#sky);
    const metal = metalness[texel]!;
    for (let channel = 0; channel < 3; channel++) {
      const at = 3 * texel + channel;
      const f0 = baseReflectance(albedo[at]!, metal);
      const lit = free * this.#sky[channel]! + (1 - free) * this.#around[at]!;
      out[channel]! += (f0 * scale + bias) * lit;
    }
  }

  /** Return the unoccluded share of the specular lobe about the mirror direction. */
  #freeShare(texel: number, perceptualRoughness: number): number {
    const { visibility } = this.scene.transport;
    const { bands, scales, offsets, steps, rows } = visibility;
    const place = Math.min(Math.max(perceptualRoughness, 0), 1) * (numLobeSteps - 1);
    const step = Math.min(Math.floor(place), numLobeSteps - 2);
    const values = basis([this.#mirror[0]!, this.#mirror[1]!, this.#mirror[2]!], bands);
    const layer = 4 * rows * tableWidth;
    let sum = 0;
    for (let band = 0; band < bands; band++) {
      const at = step * bands + band;
      const [low, high] = [this.scene.lobes[at]!, this.scene.lobes[at + bands]!];
      const factor = low + (place - step) * (high - low);
      for (let k = band * band; k < (band + 1) ** 2; k++) {
        const stored = steps[(k >> 2) * layer + 4 * texel + (k & 3)]!;
        sum += factor * values[k]! * (offsets[k]! + scales[k]! * stored);
      }
    }
    return Math.min(Math.max(sum, 0), 1);
  }
}
