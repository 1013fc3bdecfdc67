/**
 * Radiance of the object towards the camera: the formula of `lambent_relight.baked.shading`, per pixel.
 *
 *     radiance = (1 - m) albedo / pi (E_direct + E_indirect)
 *              + (F0 scale + bias) (s prefiltered(mirror) + (1 - s) surroundings) + dominant lights
 *
 * Materials, visibility and irradiance are means over the samples of a pixel; the rest is computed once, or for every
 * sample where they differ too much.
 */

import type { DataTexture, RawShaderMaterial, Texture } from "three";
import type { LoadedBundle } from "../bundle/load.js";
import { screenProgram, setUniforms } from "./fullScreen.js";
import { dominantUniforms } from "./irradiance.js";
import { type StageLight, turnMatrix } from "./light.js";
import { channels, type LightTurn, type Look, type Method, type ViewCamera } from "./looks.js";
import { basisStatements } from "./shaders.js";
import cameraRays from "./shaders/camera.glsl?raw";
import environment from "./shaders/environment.glsl?raw";
import freeShare from "./shaders/freeShare.glsl?raw";
import glints from "./shaders/glints.glsl?raw";
import samples from "./shaders/samples.glsl?raw";
import fragment from "./shaders/shading.frag.glsl?raw";
import shadowShare from "./shaders/shadowShare.glsl?raw";
import splitSum from "./shaders/splitSum.glsl?raw";
import type { ShadowCaster } from "./shadowMaps.js";
import { type BundleTextures, normalisedScales } from "./textures.js";

/** Return the program for transport of some bands. */
function program(bands: number, hasGrid: boolean): RawShaderMaterial {
  // Four numbers to a vector, as the tables have them.
  const macros = {
    ...(hasGrid ? { HAS_GRID: 1 } : {}),
    OPEN_LAYERS: Math.ceil((bands * bands) / 4),
    LOBE_ROWS: Math.ceil(bands / 4),
    ADD_OPENNESS: basisStatements(
      bands,
      (index, band, value) =>
        `total += lobe[${band >> 2}][${band & 3}] * open[${index >> 2}][${index & 3}] * ${value};`,
    ),
    ADD_PLAIN: basisStatements(3, (index, _, value) => `sum += plainIrradiance[${index}] * ${value};`),
  };
  const parts = [samples, cameraRays, environment, splitSum, glints, shadowShare, freeShare, fragment];
  return screenProgram(parts, macros);
}

/** The pass that shades what the samples show. */
export class Shading {
  readonly material: RawShaderMaterial;

  constructor(
    private readonly bundle: LoadedBundle,
    textures: BundleTextures,
    splitSumTable: DataTexture,
  ) {
    const { transport } = textures;
    const grid = bundle.uncertainty;
    this.material = program(transport.visibility.bands, grid !== null);
    setUniforms(this.material, {
      visibility: textures.visibility,
      visibilityScales: normalisedScales(transport.visibility),
      visibilityOffsets: transport.visibility.offsets,
      lobeTable: textures.lobeTable,
      splitSumTable,
      uncertainty: textures.uncertainty,
      gridLow: grid?.low ?? [0, 0, 0],
      gridSize: grid?.high.map((value, axis) => value - grid.low[axis]!) ?? [1, 1, 1],
    });
  }

  /** Set which samples are shaded, and for which camera: their two textures, and what is covered, or null. */
  aim(
    textures: readonly (Texture | null)[],
    samples: number,
    camera: ViewCamera,
    depthRange: readonly number[],
  ): void {
    const [seen, facing, mask] = textures;
    setUniforms(this.material, {
      seen,
      facing,
      mask,
      masked: mask !== null,
      samples,
      depthRange,
      ...cameraUniforms(camera),
    });
  }

  light(look: Look, method: Method, light: StageLight, turn: LightTurn, caster: ShadowCaster): void {
    const gain = look.edit.albedoGain.map((value, channel) => value * this.bundle.albedoScaleRgb[channel]!);
    setUniforms(this.material, {
      ...lightUniforms(light, turn),
      ...dominantUniforms(light.dominant(turn)),
      ...caster.uniforms(light.cast(turn), light.shadows),
      irradiance: light.tables.direct,
      bounced: light.tables.indirect,
      plainIrradiance: light.plainIrradiance(turn),
      channel: channels[look.channel],
      plain: method === "plain",
      indirect: look.indirect,
      albedoGain: gain,
      roughnessScale: look.edit.roughnessScale,
      metalnessShift: look.edit.metalnessShift,
    });
  }

  dispose(): void {
    this.material.dispose();
  }
}

/** Return the uniforms of environment.glsl. */
export function lightUniforms(light: StageLight, turn: LightTurn): Record<string, unknown> {
  return {
    levels: light.levels,
    levelPlaces: light.places,
    // A matrix by rows, read by columns, is its transpose: from the world to the map.
    toMap: turnMatrix(turn).flat(),
    lightScale: turn.intensity,
  };
}

/** Return the uniforms that give where the camera is, and the ray of a pixel. */
export function cameraUniforms(camera: ViewCamera): Record<string, unknown> {
  const pose = camera.cameraToWorld;
  return {
    size: [camera.width, camera.height],
    lens: [camera.focalX, camera.focalY, camera.centreX, camera.centreY],
    cameraTurn: [0, 4, 8, 1, 5, 9, 2, 6, 10].map((index) => pose[index]!),
    eye: [pose[3]!, pose[7]!, pose[11]!],
  };
}
