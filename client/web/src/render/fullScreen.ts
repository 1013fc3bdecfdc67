/** Draws programs over a whole target. */

import {
  BufferAttribute,
  BufferGeometry,
  Camera,
  GLSL3,
  Mesh,
  NoBlending,
  RawShaderMaterial,
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

/** One triangle that covers everything. */
export class FullScreen {
  readonly #geometry = new BufferGeometry();
  readonly #mesh: Mesh;
  readonly #scene = new Scene();
  readonly #camera = new Camera();

  constructor(private readonly renderer: WebGLRenderer) {
    const corners = new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]);
    this.#geometry.setAttribute("position", new BufferAttribute(corners, 3));
    this.#mesh = new Mesh(this.#geometry);
    this.#mesh.frustumCulled = false;
    this.#scene.add(this.#mesh);
    this.#scene.matrixWorldAutoUpdate = false;
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
