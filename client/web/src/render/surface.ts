/** The surface at each sample of a picture: the mesh, drawn once per camera. */

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  GLSL3,
  Mesh,
  NearestFilter,
  NoBlending,
  type PixelFormat,
  RawShaderMaterial,
  RedFormat,
  RedIntegerFormat,
  RGBAIntegerFormat,
  type Texture,
  UnsignedIntType,
  WebGLRenderTarget,
} from "three";
import type { AtlasMesh } from "../bundle/mesh.js";
import * as glsl from "./glsl.js";
import type { BundleTextures } from "./textures.js";

const vertex = `${glsl.header}
in vec3 position;
in vec2 uv;
in vec3 normal;
in vec4 tangent;
out vec3 upright;
out vec4 along;
uniform mat4 viewMatrix;
uniform mat4 projectionMatrix;
out vec2 place;
out vec3 world;
void main() {
  place = uv;
  world = position;
  upright = normal;
  along = tangent;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}`;

/**
 * Looks a texture up, trilinear, but in no version whose charts lie too near to each other: `lastLevel` is the number
 * of the last one.
 */
const mapAt = `
vec4 mapAt(sampler2D map, float lastLevel) {
  vec2 size = vec2(textureSize(map, 0));
  vec2 across = dFdx(place), down = dFdy(place);
  float widest = sqrt(max(dot(across * size, across * size), dot(down * size, down * size)));
  float shrink = min(exp2(lastLevel) / max(widest, 1e-9), 1.0);
  return textureGrad(map, place, across * shrink, down * shrink);
}`;

/** Return the look-up of a texture; one with a single version needs no derivatives. */
function lookUp(map: string, texture: Texture, leastSize: number): string {
  const { width } = texture.image as { readonly width: number };
  const lastLevel = Math.floor(Math.log2(width / leastSize));
  return lastLevel < 1 ? `textureLod(${map}, place, 0.0)` : `mapAt(${map}, ${lastLevel}.0)`;
}

/**
 * A sample: its place in the atlas in two halves of 16 bits; the bits of the distance, zero where nothing is; 16 bits
 * for each channel of linear albedo, 8 for roughness, 8 for metalness. Beside it the normal in two halves, octahedral.
 */
function fragment(textures: BundleTextures): string {
  const found = (map: "albedoMap" | "packedMap" | "normalMap"): string =>
    lookUp(map, textures[map], textures.transport.size);
  return `${glsl.header}
in vec2 place;
in vec3 world;
in vec3 upright;
in vec4 along;
layout(location = 0) out uvec4 result;
layout(location = 1) out uvec4 facing;
uniform vec3 cameraPosition;
uniform float floorHeight;
uniform sampler2D albedoMap;
uniform sampler2D packedMap;
uniform sampler2D normalMap;${mapAt}
vec2 folded(vec3 n) {
  vec2 at = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
  vec2 away = vec2(at.x >= 0.0 ? 1.0 : -1.0, at.y >= 0.0 ? 1.0 : -1.0);
  return n.z >= 0.0 ? at : (1.0 - abs(at.yx)) * away;
}
void main() {
  if (world.z < floorHeight) discard;
  vec3 albedo = ${found("albedoMap")}.rgb;
  vec2 rest = ${found("packedMap")}.gb;
  // As BakedScene.normals_at of Python.
  vec3 n = normalize(upright), t = normalize(along.xyz);
  vec3 b = normalize(sign(along.w) * cross(n, t));
  vec3 local = 2.0 * ${found("normalMap")}.xyz - 1.0;
  vec3 normal = normalize(local.x * t + local.y * b + local.z * n);
  uvec2 bytes = uvec2(round(clamp(rest, 0.0, 1.0) * 255.0));
  result = uvec4(
    packUnorm2x16(place),
    floatBitsToUint(length(cameraPosition - world)),
    packUnorm2x16(albedo.rg),
    (packUnorm2x16(vec2(albedo.b, 0.0)) & 0xffffu) | bytes.x << 16 | bytes.y << 24
  );
  facing = uvec4(packSnorm2x16(folded(normal)), 0u, 0u, 0u);
}`;
}

/** Return a target for samples. */
export function sampleTarget(width: number, height: number): WebGLRenderTarget {
  const target = new WebGLRenderTarget(width, height, {
    count: 2,
    format: RGBAIntegerFormat,
    type: UnsignedIntType,
    minFilter: NearestFilter,
    magFilter: NearestFilter,
  });
  const [sample, facing] = target.textures;
  sample!.internalFormat = "RGBA32UI";
  facing!.format = RedIntegerFormat as PixelFormat;
  facing!.internalFormat = "R32UI";
  return target;
}

/** Return a target for the share of every pixel that is covered, of four samples. */
export function maskTarget(width: number, height: number): WebGLRenderTarget {
  return new WebGLRenderTarget(width, height, {
    ...{ format: RedFormat, samples: 4, minFilter: NearestFilter, magFilter: NearestFilter },
    depthBuffer: false,
  });
}

const noFloor = -1e30;

const maskFragment = `${glsl.header}
in vec3 world;
uniform float floorHeight;
out vec4 result;
void main() {
  if (world.z < floorHeight) discard;
  result = vec4(1.0);
}`;

/** The mesh with its programs. */
export class Surface {
  readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;
  readonly program: RawShaderMaterial;
  /** Draws what is covered. */
  readonly mask: RawShaderMaterial;
  readonly #floor = { value: noFloor };

  constructor(mesh: AtlasMesh, textures: BundleTextures) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(mesh.positionsXyz, 3));
    geometry.setAttribute("uv", new BufferAttribute(mesh.uv, 2));
    geometry.setAttribute("normal", new BufferAttribute(mesh.normalsXyz, 3));
    geometry.setAttribute("tangent", new BufferAttribute(mesh.tangentsXyzw, 4));
    geometry.setIndex(new BufferAttribute(mesh.indices, 1));
    this.mask = new RawShaderMaterial({
      ...{ glslVersion: GLSL3, vertexShader: vertex, fragmentShader: maskFragment },
      ...{ side: DoubleSide, blending: NoBlending, depthTest: false, depthWrite: false },
      uniforms: { floorHeight: this.#floor },
    });
    this.program = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: vertex,
      fragmentShader: fragment(textures),
      uniforms: {
        albedoMap: { value: textures.albedoMap },
        packedMap: { value: textures.packedMap },
        normalMap: { value: textures.normalMap },
        floorHeight: this.#floor,
      },
      side: DoubleSide,
      blending: NoBlending,
    });
    this.mesh = new Mesh(geometry, this.program);
    this.mesh.frustumCulled = false;
  }

  /** Leave out what lies under a height; null: nothing. */
  set floor(height: number | null) {
    this.#floor.value = height ?? noFloor;
    this.program.uniformsNeedUpdate = true;
    this.mask.uniformsNeedUpdate = true;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.program.dispose();
    this.mask.dispose();
  }
}
