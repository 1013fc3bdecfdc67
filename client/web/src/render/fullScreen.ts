/** Draws programs over a whole target. */

import {
  BufferAttribute,
  BufferGeometry,
  Camera,
  DoubleSide,
  GLSL3,
  Mesh,
  NoBlending,
  RawShaderMaterial,
  type ShaderMaterialParameters,
  Scene,
  type WebGLRenderer,
  type WebGLRenderTarget,
} from "three";
import { type Macros, shader } from "./shaders.js";
import cover from "./shaders/cover.vert.glsl?raw";

/** Return a program that writes every pixel of a target; the uniforms that its parts declare are yet to be given. */
export function screenProgram(parts: readonly string[], macros: Macros = {}): RawShaderMaterial {
  const fragmentShader = shader(parts, macros);
  const names = [...fragmentShader.matchAll(/uniform \w+ (\w+)/g)].map(([, name]) => name!);
  return new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: shader([cover]),
    fragmentShader,
    uniforms: Object.fromEntries(names.map((name) => [name, { value: null }])),
    depthTest: false,
    depthWrite: false,
    blending: NoBlending,
  });
}

/** Give uniforms of a program their values; those it does not have are left out. */
export function setUniforms(program: RawShaderMaterial, values: Readonly<Record<string, unknown>>): void {
  for (const [name, value] of Object.entries(values)) {
    const uniform = program.uniforms[name];
    if (uniform !== undefined) uniform.value = value;
  }
}

/** Return a program that draws a mesh from both sides; its parts are those of `shader`. */
export function meshProgram(
  vertex: string,
  fragment: readonly string[],
  uniforms: Readonly<Record<string, { value: unknown }>>,
  more: ShaderMaterialParameters = {},
  macros: Macros = {},
): RawShaderMaterial {
  return new RawShaderMaterial({
    ...{ glslVersion: GLSL3, side: DoubleSide, blending: NoBlending },
    vertexShader: shader([vertex]),
    fragmentShader: shader(fragment, macros),
    uniforms,
    ...more,
  });
}

/** Return a scene of one mesh that is drawn by a program of its own, wherever it is. */
export function sceneOf(mesh: Mesh): Scene {
  const scene = new Scene();
  mesh.frustumCulled = false;
  scene.add(mesh);
  scene.matrixWorldAutoUpdate = false;
  return scene;
}

/** One triangle that covers everything. */
export class FullScreen {
  readonly #geometry = new BufferGeometry();
  readonly #mesh: Mesh;
  readonly #scene: Scene;
  readonly #camera = new Camera();

  constructor(private readonly renderer: WebGLRenderer) {
    const corners = new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]);
    this.#geometry.setAttribute("position", new BufferAttribute(corners, 3));
    this.#mesh = new Mesh(this.#geometry);
    this.#scene = sceneOf(this.#mesh);
  }

  /** Draw a program into a target, or onto the canvas. */
  draw(material: RawShaderMaterial, target: WebGLRenderTarget | null): void {
    this.#mesh.material = material;
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.#scene, this.#camera);
  }

  /** Let the browser compile a program before it is needed. */
  compile(material: RawShaderMaterial): void {
    this.#mesh.material = material;
    this.renderer.compile(this.#scene, this.#camera);
  }

  dispose(): void {
    this.#geometry.dispose();
  }
}
