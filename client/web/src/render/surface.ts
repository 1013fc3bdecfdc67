/** The texel and distance at each sample of a picture: the mesh, drawn once per camera. */

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  GLSL3,
  Mesh,
  NearestFilter,
  NoBlending,
  RawShaderMaterial,
  RGBAIntegerFormat,
  RGIntegerFormat,
  UnsignedIntType,
  WebGLRenderTarget,
} from "three";
import type { AtlasMesh } from "../bundle/mesh.js";
import * as glsl from "./glsl.js";
import type { BundleTextures } from "./textures.js";

const vertex = `${glsl.header}
in vec3 position;
in vec2 uv;
uniform mat4 viewMatrix;
uniform mat4 projectionMatrix;
out vec2 place;
out vec3 world;
void main() {
  place = uv;
  world = position;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}`;

// The number of the texel plus one, zero where nothing is; the bits of the distance. Where the mesh's textures
// are the materials also these: 16 bits for each channel of linear albedo, 8 for roughness, 8 for metalness.
const fragment = (mapped: boolean): string => `${glsl.header}
in vec2 place;
in vec3 world;
out uvec4 result;
uniform vec3 cameraPosition;
uniform usampler2D texelPlane;
${mapped ? "uniform sampler2D albedoMap;\nuniform sampler2D packedMap;\nuniform float lastLevel;" : ""}
uvec2 material() {
  ${
    mapped
      ? `vec2 size = vec2(textureSize(albedoMap, 0));
  vec2 across = dFdx(place) * size, down = dFdy(place) * size;
  float level = 0.5 * log2(max(max(dot(across, across), dot(down, down)), 1.0));
  vec3 albedo = textureLod(albedoMap, place, min(level, lastLevel)).rgb;
  vec2 rest = textureLod(packedMap, place, 0.0).gb;
  uvec2 bytes = uvec2(round(clamp(rest, 0.0, 1.0) * 255.0));
  return uvec2(packUnorm2x16(albedo.rg), (packUnorm2x16(vec2(albedo.b, 0.0)) & 0xffffu) | bytes.x << 16 | bytes.y << 24);`
      : "return uvec2(0u);"
  }
}
void main() {
  int size = textureSize(texelPlane, 0).x;
  ivec2 at = clamp(ivec2(place * float(size)), ivec2(0), ivec2(size - 1));
  uint texel = texelFetch(texelPlane, at, 0).r;
  result = uvec4(texel + 1u, floatBitsToUint(length(cameraPosition - world)), material());
}`;

/** Return a target for samples; `mapped` ones carry their material. */
export function sampleTarget(width: number, height: number, mapped: boolean): WebGLRenderTarget {
  const target = new WebGLRenderTarget(width, height, {
    format: mapped ? RGBAIntegerFormat : RGIntegerFormat,
    type: UnsignedIntType,
    minFilter: NearestFilter,
    magFilter: NearestFilter,
  });
  target.texture.internalFormat = mapped ? "RGBA32UI" : "RG32UI";
  return target;
}

/** The mesh with its program. */
export class Surface {
  readonly mesh: Mesh<BufferGeometry, RawShaderMaterial>;

  constructor(mesh: AtlasMesh, textures: BundleTextures) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(mesh.positionsXyz, 3));
    geometry.setAttribute("uv", new BufferAttribute(mesh.uv, 2));
    geometry.setIndex(new BufferAttribute(mesh.indices, 1));
    const program = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: vertex,
      fragmentShader: fragment(textures.albedoMap !== null),
      uniforms: {
        texelPlane: { value: textures.texelPlane },
        albedoMap: { value: textures.albedoMap },
        packedMap: { value: textures.packedMap },
        lastLevel: { value: textures.lastLevel },
      },
      side: DoubleSide,
      blending: NoBlending,
    });
    this.mesh = new Mesh(geometry, program);
    this.mesh.frustumCulled = false;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
