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

// The number of the texel plus one, zero where nothing is; the bits of the distance.
const fragment = `${glsl.header}
in vec2 place;
in vec3 world;
out uvec4 result;
uniform vec3 cameraPosition;
uniform usampler2D texelPlane;
void main() {
  int size = textureSize(texelPlane, 0).x;
  ivec2 at = clamp(ivec2(place * float(size)), ivec2(0), ivec2(size - 1));
  uint texel = texelFetch(texelPlane, at, 0).r;
  result = uvec4(texel + 1u, floatBitsToUint(length(cameraPosition - world)), 0u, 0u);
}`;

/** Return a target for samples. */
export function sampleTarget(width: number, height: number): WebGLRenderTarget {
  const target = new WebGLRenderTarget(width, height, {
    format: RGIntegerFormat,
    type: UnsignedIntType,
    minFilter: NearestFilter,
    magFilter: NearestFilter,
  });
  target.texture.internalFormat = "RG32UI";
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
      fragmentShader: fragment,
      uniforms: { texelPlane: { value: textures.texelPlane } },
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
