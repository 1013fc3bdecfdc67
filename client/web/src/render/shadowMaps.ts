/**
 * Shadows of dominant lights from depth maps of the mesh, as `lambent_relight.baked.shadow_maps`: the blockers in the
 * cone of a light's disc give the width of the penumbra, and the share of lit texels inside it that of the light.
 */

import {
  Camera,
  DepthTexture,
  LessDepth,
  Mesh,
  NearestFilter,
  type RawShaderMaterial,
  RedFormat,
  type Scene,
  type BufferGeometry,
  type Texture,
  UnsignedIntType,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import { shadowMapSide } from "../contract/constants.js";
import type { Direction } from "../engine/environment.js";
import { maxDominant } from "../light/prepare.js";
import type { Ball } from "./ball.js";
import { meshProgram, sceneOf, setUniforms } from "./fullScreen.js";
import castFragment from "./shaders/shadowCast.frag.glsl?raw";
import castVertex from "./shaders/shadowCast.vert.glsl?raw";

/** Return two unit vectors across a direction, and itself. */
export function lightAxes(direction: Direction): readonly [Direction, Direction, Direction] {
  const [x, y, z] = direction;
  const level = Math.hypot(x, y);
  const first: Direction = level > 1e-3 ? [-y / level, x / level, 0] : [1, 0, 0];
  const second: Direction = [
    y * first[2] - z * first[1],
    z * first[0] - x * first[2],
    x * first[1] - y * first[0],
  ];
  return [first, second, direction];
}

/** Lights as they stand over the object. */
export type CastLights = {
  readonly directions: readonly Direction[];
  readonly radiiRad: readonly number[];
};

/** Draws the maps of one object; maps of four lights lie two by two in one texture. */
export class ShadowCaster {
  readonly #cast: RawShaderMaterial;
  readonly #scene: Scene;
  readonly #camera = new Camera();

  constructor(
    geometry: BufferGeometry,
    private readonly ball: Ball,
  ) {
    const place = { ballCentre: { value: ball.centre }, ballRadius: { value: ball.radius } };
    const writing = { depthFunc: LessDepth, colorWrite: false } as const;
    this.#cast = meshProgram(castVertex, [castFragment], { axes: { value: null }, ...place }, writing);
    this.#scene = sceneOf(new Mesh(geometry, this.#cast));
  }

  draw(renderer: WebGLRenderer, { directions }: CastLights, into: ShadowMaps): void {
    const { target } = into;
    target.viewport.set(0, 0, target.width, target.height);
    renderer.setRenderTarget(target);
    renderer.clear();
    directions.slice(0, maxDominant).forEach((direction, light) => {
      target.viewport.set(
        (light % 2) * shadowMapSide,
        (light >> 1) * shadowMapSide,
        shadowMapSide,
        shadowMapSide,
      );
      // A vector times the matrix is its products with the columns.
      setUniforms(this.#cast, { axes: lightAxes(direction).flat() });
      this.#cast.uniformsNeedUpdate = true;
      renderer.setRenderTarget(target);
      renderer.render(this.#scene, this.#camera);
    });
  }

  /** Return the uniforms of shadowShare.glsl. */
  uniforms({ directions, radiiRad }: CastLights, maps: ShadowMaps | null): Record<string, unknown> {
    const [right, up] = [new Float32Array(3 * maxDominant), new Float32Array(3 * maxDominant)];
    const tangents = new Float32Array(maxDominant);
    directions.slice(0, maxDominant).forEach((direction, light) => {
      const axes = lightAxes(direction);
      right.set(axes[0], 3 * light);
      up.set(axes[1], 3 * light);
      tangents[light] = Math.tan(radiiRad[light]!);
    });
    return {
      ...{ lightRight: right, lightUp: up, lightTangents: tangents },
      ...{ shadowDepths: maps?.depths ?? null, ballCentre: this.ball.centre, ballRadius: this.ball.radius },
    };
  }

  dispose(): void {
    this.#cast.dispose();
  }
}

/** The maps of the lights of one environment. */
export class ShadowMaps {
  readonly target: WebGLRenderTarget;

  constructor() {
    const side = 2 * shadowMapSide;
    const depths = new DepthTexture(side, side, UnsignedIntType);
    depths.minFilter = NearestFilter;
    depths.magFilter = NearestFilter;
    this.target = new WebGLRenderTarget(side, side, { format: RedFormat, depthTexture: depths });
  }

  get depths(): Texture {
    return this.target.depthTexture!;
  }

  dispose(): void {
    this.target.depthTexture?.dispose();
    this.target.dispose();
  }
}
