/** The surface at each sample of a picture: the mesh, drawn once per camera. */

import {
  BufferAttribute,
  BufferGeometry,
  Mesh,
  NearestFilter,
  type PixelFormat,
  type RawShaderMaterial,
  RedFormat,
  RedIntegerFormat,
  RGBAIntegerFormat,
  type Texture,
  UnsignedIntType,
  WebGLRenderTarget,
} from "three";
import type { AtlasMesh } from "../bundle/mesh.js";
import { meshProgram } from "./fullScreen.js";
import maskFragment from "./shaders/mask.frag.glsl?raw";
import samples from "./shaders/samples.glsl?raw";
import fragment from "./shaders/surface.frag.glsl?raw";
import vertex from "./shaders/surface.vert.glsl?raw";
import type { BundleTextures } from "./textures.js";

/** Return the number of the last version of a texture whose charts do not lie too near to each other. */
function lastLevel(texture: Texture, leastSize: number): number {
  const { width } = texture.image as { readonly width: number };
  return Math.floor(Math.log2(width / leastSize));
}

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
    const floorHeight = this.#floor;
    const flat = { depthTest: false, depthWrite: false };
    this.mask = meshProgram(vertex, [maskFragment], { floorHeight }, flat);
    const { albedoMap, packedMap, normalMap, transport } = textures;
    const uniforms = {
      albedoMap: { value: albedoMap },
      packedMap: { value: packedMap },
      normalMap: { value: normalMap },
      floorHeight,
    };
    const macros = {
      ALBEDO_LEVEL: lastLevel(albedoMap, transport.size),
      PACKED_LEVEL: lastLevel(packedMap, transport.size),
      NORMAL_LEVEL: lastLevel(normalMap, transport.size),
    };
    this.program = meshProgram(vertex, [samples, fragment], uniforms, {}, macros);
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
