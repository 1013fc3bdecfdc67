/**
 * Shadows of dominant lights from depth maps of the mesh, as `lambent_relight.baked.shadow_maps`: the blockers in the
 * cone of a light's disc give the width of the penumbra, and the share of lit texels inside it that of the light.
 */

import {
  Camera,
  DepthTexture,
  DoubleSide,
  GLSL3,
  LessDepth,
  Mesh,
  NearestFilter,
  NoBlending,
  RawShaderMaterial,
  RedFormat,
  Scene,
  type BufferGeometry,
  type Texture,
  UnsignedIntType,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import type { Direction } from "../engine/environment.js";
import { maxDominant } from "../light/prepare.js";
import type { Ball } from "./ball.js";
import { setUniforms } from "./fullScreen.js";
import { header } from "./glsl.js";

/** Texels along a side of a map; maps of four lights lie two by two in one texture. */
export const mapSide = 1024;
const [blockerTaps, filterTaps] = [12, 16];
/** Texels over which the border of a shadow is smoothed at least. */
const leastRadius = 1.25;
/** Texels of depth that a blocker is nearer to the light at least. */
const bias = 1.5;
/** Steeper planes than this are taken to be this steep. */
const leastCosine = 0.08;

const castVertex = `${header}
in vec3 position;
uniform mat3 axes;
uniform vec3 ballCentre;
uniform float ballRadius;
void main() {
  vec3 place = (position - ballCentre) * axes / ballRadius;
  gl_Position = vec4(place.xy, -place.z, 1.0);
}`;

const castFragment = `${header}
out vec4 result;
void main() { result = vec4(0.0); }`;

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
  /** Radii of their discs. */
  readonly radiiRad: readonly number[];
};

/** Draws the maps of one object. */
export class ShadowCaster {
  readonly #cast: RawShaderMaterial;
  readonly #scene = new Scene();
  readonly #camera = new Camera();

  constructor(
    geometry: BufferGeometry,
    private readonly ball: Ball,
  ) {
    this.#cast = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: castVertex,
      fragmentShader: castFragment,
      uniforms: {
        axes: { value: null },
        ballCentre: { value: ball.centre },
        ballRadius: { value: ball.radius },
      },
      side: DoubleSide,
      depthFunc: LessDepth,
      blending: NoBlending,
      colorWrite: false,
    });
    const mesh = new Mesh(geometry, this.#cast);
    mesh.frustumCulled = false;
    this.#scene.add(mesh);
    this.#scene.matrixWorldAutoUpdate = false;
  }

  /** Draw the maps of lights. */
  draw(renderer: WebGLRenderer, { directions }: CastLights, into: ShadowMaps): void {
    const { target } = into;
    target.viewport.set(0, 0, target.width, target.height);
    renderer.setRenderTarget(target);
    renderer.clear();
    directions.slice(0, maxDominant).forEach((direction, light) => {
      target.viewport.set((light % 2) * mapSide, (light >> 1) * mapSide, mapSide, mapSide);
      // A vector times the matrix is its products with the columns.
      setUniforms(this.#cast, { axes: lightAxes(direction).flat() });
      this.#cast.uniformsNeedUpdate = true;
      renderer.setRenderTarget(target);
      renderer.render(this.#scene, this.#camera);
    });
  }

  /** Return the uniforms of `shadowLook`. */
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
    const side = 2 * mapSide;
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

/** The share of a dominant light that reaches a point which faces it; needs the uniforms of `glsl.glints`. */
export const shadowLook = `
uniform sampler2D shadowDepths;
uniform vec3 lightRight[${maxDominant}];
uniform vec3 lightUp[${maxDominant}];
uniform float lightTangents[${maxDominant}];
uniform vec3 ballCentre;
uniform float ballRadius;
float depthAt(int light, vec2 place) {
  ivec2 at = clamp(ivec2((place + 1.0) * ${(0.5 * mapSide).toFixed(1)}), ivec2(0), ivec2(${mapSide - 1}));
  return texelFetch(shadowDepths, at + ivec2(light % 2, light / 2) * ${mapSide}, 0).r;
}
vec2 tap(int index, float count, float turn) {
  float angle = float(index) * ${(Math.PI * (3 - Math.sqrt(5))).toFixed(9)} + turn;
  return sqrt((float(index) + 0.5) / count) * vec2(cos(angle), sin(angle));
}
/** Interleaved gradient noise, as a turn of the pattern of comparisons. */
float patternTurn(vec2 sampleFromTop) {
  return 2.0 * pi * fract(52.9829189 * fract(0.06711056 * sampleFromTop.x + 0.00583715 * sampleFromTop.y));
}
float shadowShare(int light, vec3 position, vec3 n, float turn) {
  const float texel = ${(2 / mapSide).toFixed(9)};
  const float least = ${leastRadius} * texel;
  vec3 right = lightRight[light], up = lightUp[light], towards = lightDirections[light];
  vec3 from = (position - ballCentre) / ballRadius;
  vec2 place = vec2(dot(from, right), dot(from, up));
  float height = dot(from, towards);
  float cosine = dot(n, towards);
  float steep = max(cosine, ${leastCosine});
  vec2 slope = 0.5 / steep * vec2(dot(n, right), dot(n, up));
  float own = 0.5 - 0.5 * height - ${(0.5 * bias).toFixed(2)} * texel * (1.0 + (1.0 - cosine) / steep);
  float reach = max(lightTangents[light] * (1.0 - height), least);
  float count = 0.0, width = 0.0;
  for (int index = 0; index < ${blockerTaps}; index++) {
    vec2 away = reach * tap(index, ${blockerTaps}.0, turn);
    float gap = own + dot(slope, away) - depthAt(light, place + away);
    count += gap > 0.0 ? 1.0 : 0.0;
    width += max(gap, 0.0);
  }
  if (count == 0.0) return 1.0;
  if (count == ${blockerTaps}.0) return 0.0;
  float spread = min(max(2.0 * lightTangents[light] * width / count, least), reach);
  float free = 0.0;
  for (int index = 0; index < ${filterTaps}; index++) {
    vec2 away = spread * tap(index, ${filterTaps}.0, turn);
    free += own + dot(slope, away) <= depthAt(light, place + away) ? 1.0 : 0.0;
  }
  return free / ${filterTaps}.0;
}
`;
