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
import * as glsl from "./glsl.js";
import { screenProgram, setUniforms } from "./fullScreen.js";
import { dominantUniforms } from "./irradiance.js";
import { type StageLight, turnMatrix } from "./light.js";
import { channels, type LightTurn, type Look, type Method, type ViewCamera } from "./looks.js";
import { type ShadowCaster, shadowLook } from "./shadowMaps.js";
import { type BundleTextures, normalisedScales } from "./textures.js";

function fragment(bands: number, hasGrid: boolean): string {
  const plain = glsl.basisStatements(3, (index, _, value) => `sum += plainIrradiance[${index}] * ${value};`);
  const layers = Math.ceil((bands * bands) / 4);
  return `${glsl.header}${glsl.unfolded}${glsl.firstSample}${glsl.environment}${glsl.splitSum}${glsl.glints}${shadowLook}${glsl.freeShare(bands)}
out vec4 result;
uniform usampler2D seen;
uniform usampler2D facing;
uniform sampler2D mask;
uniform bool masked;
uniform int samples;
uniform vec2 size;
uniform vec4 lens;
uniform mat3 cameraTurn;
uniform vec3 eye;
uniform sampler2D irradiance;
uniform sampler2D bounced;
uniform vec3 plainIrradiance[9];
uniform int channel;
uniform bool plain;
uniform bool indirect;
uniform vec3 albedoGain;
uniform float roughnessScale;
uniform float metalnessShift;
uniform vec2 depthRange;
${hasGrid ? "uniform sampler3D uncertainty;\nuniform vec3 gridLow;\nuniform vec3 gridSize;" : ""}

vec3 plainSum(vec3 n) {
  float x = n.x, y = n.y, z = n.z;
  vec3 sum = vec3(0.0);
  ${plain}
  return max(sum, 0.0);
}

/** The ray of a place in the picture, in the camera's axes. */
vec3 rayOf(vec2 place) {
  return vec3((place.x - lens.z) / lens.x, -(size.y - place.y - lens.w) / lens.y, -1.0);
}

/** Whether samples of a pixel are too unlike the first for one lobe: LEAST_COSINE and MOST_DIFFERENCE of Python. */
bool differing(ivec2 first) {
  bool found = false;
  vec3 facet = vec3(0.0);
  vec2 own = vec2(0.0);
  for (int index = 0; index < samples * samples; index++) {
    // From the top, as Python's.
    ivec2 at = first + ivec2(index % samples, samples - 1 - index / samples);
    uvec4 sampled = texelFetch(seen, at, 0);
    if (sampled.g == 0u) continue;
    vec3 normal = unfolded(texelFetch(facing, at, 0).r);
    vec2 material = vec2((sampled.a >> 16) & 0xffu, sampled.a >> 24) / 255.0;
    if (!found) {
      facet = normal;
      own = material;
      found = true;
    } else if (dot(normal, facet) < 0.9 || any(greaterThan(abs(material - own), vec2(0.1)))) return true;
  }
  return false;
}

void main() {
  vec2 pixel = gl_FragCoord.xy;
  ivec2 first = ivec2(pixel) * samples;
  float covered = masked ? texelFetch(mask, first, 0).r : 1.0;
  first = firstSample(seen, first, masked, covered);
  bool lit = channel <= ${channels.indirect};
  // Samples that differ too much for one lobe reflect each for itself.
  int all = samples * samples;
  int each = lit && differing(first) ? 1 : all;
  float total = 0.0;
  vec3 sum = vec3(0.0);
  for (int from = 0; from < all; from += each) {
  float count = 0.0, distance = 0.0, roughness = 0.0, metalness = 0.0, openness = 0.0, surroundings = 0.0;
  vec3 albedo = vec3(0.0), normal = vec3(0.0), arriving = vec3(0.0), bounce = vec3(0.0);
  vec4 lightShares = vec4(0.0);
  vec4 open[${layers}];
  for (int layer = 0; layer < ${layers}; layer++) open[layer] = vec4(0.0);
  for (int index = from; index < from + each; index++) {
    ivec2 at = first + ivec2(index % samples, index / samples);
    uvec4 found = texelFetch(seen, at, 0);
    if (found.g == 0u) continue;
    vec2 where = unpackUnorm2x16(found.r);
    count += 1.0;
    distance += uintBitsToFloat(found.g);
    albedo += vec3(unpackUnorm2x16(found.b), unpackUnorm2x16(found.a).x);
    roughness += float((found.a >> 16) & 0xffu) / 255.0;
    metalness += float(found.a >> 24) / 255.0;
    vec3 facet = unfolded(texelFetch(facing, at, 0).r);
    normal += facet;
    if (lit ? plain : channel != ${channels.visibility}) continue;
    vec4 straight = textureLod(irradiance, where, 0.0);
    openness += straight.a;
    if (!lit) continue;
    arriving += straight.rgb;
    for (int layer = 0; layer < ${layers}; layer++) {
      open[layer] += textureLod(visibility, vec3(where, float(layer)), 0.0);
    }
    if (numLights > 0) {
      vec2 place = (vec2(at) + 0.5) / float(samples);
      vec3 position = eye + uintBitsToFloat(found.g) * normalize(cameraTurn * rayOf(place));
      float turn = patternTurn(vec2(at.x, size.y * float(samples) - 1.0 - float(at.y)));
      for (int light = 0; light < numLights; light++) {
        float cosine = dot(facet, lightDirections[light]);
        if (cosine <= 0.0) continue;
        float share = shadowShare(light, position, facet, turn);
        lightShares += share * vec4(equal(ivec4(light), ivec4(0, 1, 2, 3)));
        arriving += share * cosine * lightIrradiance[light];
      }
    }
    if (indirect) {
      vec4 again = textureLod(bounced, where, 0.0);
      bounce += again.rgb;
      surroundings += again.a;
    }
  }
  if (count == 0.0 || covered == 0.0) continue;
  float share = 1.0 / count;
  albedo = clamp(albedo * share * albedoGain, 0.0, 1.0);
  roughness = clamp(roughness * share * roughnessScale, 0.0, 1.0);
  metalness = clamp(metalness * share + metalnessShift, 0.0, 1.0);
  openness *= share;
  distance *= share;
  vec3 toViewer = -normalize(cameraTurn * rayOf(pixel));
  normal = normalize(normal * share);
  // A mean normal may face away at a silhouette, where the true one cannot.
  normal = normalize(normal - min(dot(normal, toViewer) - 1e-3, 0.0) * toViewer);

  vec3 shown;
  if (lit) {
    float cosine = dot(normal, toViewer);
    vec3 mirror = 2.0 * cosine * normal - toViewer;
    vec2 table = splitSum(cosine, roughness);
    vec3 f0 = mix(vec3(0.04), albedo, metalness);
    vec3 reflectance = f0 * table.x + table.y;
    vec3 diffuse = (1.0 - metalness) * albedo / pi;
    vec3 prefiltered = radianceFrom(mirror, roughness);
    if (plain) {
      shown = channel == ${channels.indirect} ? vec3(0.0) : diffuse * plainSum(normal) + reflectance * prefiltered;
    } else {
      for (int layer = 0; layer < ${layers}; layer++) {
        open[layer] = visibilityOffsets[layer] + visibilityScales[layer] * open[layer] * share;
      }
      float free = freeShare(open, mirror, roughness);
      arriving = max(arriving * share, 0.0);
      bounce = max(bounce * share * albedoGain, 0.0);
      float alpha = max(roughness * roughness, 1e-4);
      vec3 single = glints(normal, toViewer, mirror, alpha, f0, lightShares * share, prefiltered);
      vec3 straight = diffuse * arriving + reflectance * free * prefiltered + single;
      vec3 again = diffuse * bounce + reflectance * (1.0 - free) * surroundings * share * bounce;
      shown = channel == ${channels.direct} ? straight : channel == ${channels.indirect} ? again : straight + again;
    }
  } else if (channel == ${channels.visibility}) shown = vec3(openness);
  else if (channel == ${channels.albedo}) shown = albedo;
  else if (channel == ${channels.roughness}) shown = vec3(roughness);
  else if (channel == ${channels.metalness}) shown = vec3(metalness);
  else if (channel == ${channels.normal}) shown = 0.5 + 0.5 * normal;
  else if (channel == ${channels.depth}) {
    shown = vec3(1.0 - clamp((distance - depthRange.x) / (depthRange.y - depthRange.x), 0.0, 1.0));
  } else {
    vec3 world = eye - distance * toViewer;
    shown = vec3(${hasGrid ? "min(texture(uncertainty, (world - gridLow) / gridSize).r, 1.0)" : "0.0"});
  }
  sum += count * shown;
  total += count;
  }
  float coverage = masked ? covered : total / float(all);
  result = total == 0.0 ? vec4(0.0) : vec4(sum * (coverage / total), coverage);
}`;
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
    this.material = screenProgram(fragment(transport.visibility.bands, grid !== null));
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

  /** Set how they are lit. */
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

/** Return the uniforms of `glsl.environment`. */
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
