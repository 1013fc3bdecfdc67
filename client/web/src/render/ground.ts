/**
 * The shadow on level ground below the object: per point of the ground, the share of its irradiance that the
 * object keeps away.
 *
 * The mesh is drawn along a direction onto the ground, which gives exactly the points that it hides from that
 * direction: once per bundle along 256 directions of the sky, and along a few directions inside every dominant
 * light whenever that moves. The share is then a sum with the light's irradiance as weights.
 */

import {
  CustomBlending,
  DataTexture,
  FloatType,
  LessDepth,
  LinearFilter,
  Mesh,
  OneFactor,
  Camera,
  type RawShaderMaterial,
  RedFormat,
  RGBAFormat,
  type Scene,
  type BufferGeometry,
  UnsignedByteType,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import type { Direction } from "../engine/environment.js";
import { maxDominant } from "../light/prepare.js";
import { ballOf } from "./ball.js";
import { type FullScreen, meshProgram, sceneOf, screenProgram, setUniforms } from "./fullScreen.js";
import { discDirections, type GroundLight, numSky, skyDirections } from "./groundLight.js";
import type { CastLights } from "./shadowMaps.js";
import type { Look, Method } from "./looks.js";
import castFragment from "./shaders/groundCast.frag.glsl?raw";
import castVertex from "./shaders/groundCast.vert.glsl?raw";
import sharesFragment from "./shaders/groundShares.frag.glsl?raw";
import skyFragment from "./shaders/groundSky.frag.glsl?raw";
import { halfFloatTarget } from "./targets.js";

/** Half the side of the square of ground that is drawn, in radii of the object's box. */
export const reachInRadii = 2.5;
const tilesAcross = Math.sqrt(numSky);
const skySide = 128;
const lightSide = 512;
const sides = { NUM_SKY: numSky, TILES_ACROSS: tilesAcross, SKY_SIDE: skySide, LIGHT_SIDE: lightSide };
/** Directions inside a light, in motion and at rest; shares of them are whole steps of a byte. */
const discSamples = { moving: 5, still: 15 } as const;

/** A square on level ground. */
export type GroundPlace = {
  readonly centre: readonly [x: number, y: number];
  readonly height: number;
  readonly reach: number;
};

/** Return whether a picture has a ground: of radiance, and with transport, which knows shadows. */
export function hasGround({ look, method }: { readonly look: Look; readonly method: Method }): boolean {
  return look.ground && method === "baked" && (look.channel === "final" || look.channel === "direct");
}

/** Directions of the sky that are drawn for a frame of something that moves, and how far apart they are in the list. */
const skyPerFrame = 16;
const skyStride = 97;

/** Return the ground under a box at a height. */
export function groundUnder(low: readonly number[], high: readonly number[], height: number): GroundPlace {
  const { centre, radius } = ballOf(low, high);
  return { centre: [centre[0]!, centre[1]!], height, reach: reachInRadii * radius };
}

function bytes(side: number, depthBuffer: boolean): WebGLRenderTarget {
  return new WebGLRenderTarget(side, side, {
    format: RedFormat,
    type: UnsignedByteType,
    minFilter: LinearFilter,
    magFilter: LinearFilter,
    depthBuffer,
  });
}

export class Ground {
  readonly #tiles = bytes(tilesAcross * skySide, false);
  readonly #lights = bytes(2 * lightSide, true);
  readonly #sky = halfFloatTarget(skySide, skySide, LinearFilter);
  readonly #skyLight = new DataTexture(new Float32Array(4 * numSky), numSky, 1, RGBAFormat, FloatType);
  readonly #skyPass = screenProgram([skyFragment], sides);
  readonly #sharePass = screenProgram([sharesFragment], sides);
  readonly #cast: RawShaderMaterial;
  readonly #scene: Scene;
  readonly #camera = new Camera();
  /** How many directions of the sky its tiles hold. */
  #drawn = 0;

  constructor(
    geometry: BufferGeometry,
    readonly place: GroundPlace,
  ) {
    const { centre, height, reach } = place;
    const uniforms = {
      place: { value: [...centre, height, reach] },
      slope: { value: [0, 0] },
      layer: { value: 0 },
      share: { value: 1 },
    };
    const adding = { blending: CustomBlending, blendSrc: OneFactor, blendDst: OneFactor } as const;
    this.#cast = meshProgram(castVertex, [castFragment], uniforms, { depthFunc: LessDepth, ...adding });
    this.#scene = sceneOf(new Mesh(geometry, this.#cast));
    setUniforms(this.#skyPass, { tiles: this.#tiles.texture, skyLight: this.#skyLight });
    setUniforms(this.#sharePass, { sky: this.#sky.texture, lights: this.#lights.texture });
  }

  /** Whether all of the sky is known; what is not yet throws no shadow. */
  get isWhole(): boolean {
    return this.#drawn === numSky;
  }

  /**
   * Draw the shares that a light loses into a table; `still` draws discs finely, and all of the sky, of which pictures
   * of something that moves, and the first one, do with a part that grows.
   */
  draw(
    renderer: WebGLRenderer,
    screen: FullScreen,
    light: GroundLight,
    lights: CastLights,
    into: WebGLRenderTarget,
    still: boolean,
  ): void {
    this.#drawTiles(renderer, still ? numSky : Math.min(this.#drawn + skyPerFrame, numSky));
    this.#drawLights(renderer, lights, still ? discSamples.still : discSamples.moving);
    (this.#skyLight.image.data as Float32Array).set(light.skyRgba);
    this.#skyLight.needsUpdate = true;
    screen.draw(this.#skyPass, this.#sky);
    const rgb = new Float32Array(3 * maxDominant);
    light.lightsRgb.slice(0, maxDominant).forEach((value, index) => {
      rgb.set(value, 3 * index);
    });
    const numLights = Math.min(light.lightsRgb.length, maxDominant);
    setUniforms(this.#sharePass, { lightsRgb: rgb, numLights, whole: light.wholeRgb });
    screen.draw(this.#sharePass, into);
  }

  /** Draw everything again on the next use. */
  forget(): void {
    this.#drawn = 0;
  }

  dispose(): void {
    for (const target of [this.#tiles, this.#lights, this.#sky]) target.dispose();
    for (const pass of [this.#skyPass, this.#sharePass, this.#cast]) pass.dispose();
    this.#skyLight.dispose();
  }

  /** Draw tiles until there are `count`. */
  #drawTiles(renderer: WebGLRenderer, count: number): void {
    if (this.isWhole) return;
    if (this.#drawn === 0) clear(renderer, this.#tiles);
    const directions = skyDirections(numSky);
    for (; this.#drawn < count; this.#drawn++) {
      // From everywhere alike, so that the shadow becomes darker and does not wander.
      const index = (this.#drawn * skyStride) % numSky;
      const direction = directions[index]!;
      const corner = [index % tilesAcross, Math.floor(index / tilesAcross)];
      this.#tiles.viewport.set(corner[0]! * skySide, corner[1]! * skySide, skySide, skySide);
      this.#castAlong(renderer, direction, 0, 1, this.#tiles);
    }
  }

  #drawLights(renderer: WebGLRenderer, { directions, radiiRad }: CastLights, count: number): void {
    clear(renderer, this.#lights);
    directions.slice(0, maxDominant).forEach((centre, light) => {
      this.#lights.viewport.set((light % 2) * lightSide, (light >> 1) * lightSide, lightSide, lightSide);
      // Each direction lies nearer than the one before, so that every pixel counts it once however often it is hit.
      discDirections(centre, radiiRad[light]!, count).forEach((direction, index) => {
        this.#castAlong(renderer, direction, 0.9 - index / count, 1 / count, this.#lights);
      });
    });
  }

  #castAlong(
    renderer: WebGLRenderer,
    [x, y, z]: Direction,
    layer: number,
    share: number,
    target: WebGLRenderTarget,
  ): void {
    setUniforms(this.#cast, { slope: [x / z, y / z], layer, share });
    this.#cast.uniformsNeedUpdate = true;
    renderer.setRenderTarget(target);
    renderer.render(this.#scene, this.#camera);
  }
}

/** Return a table of shares for one light. */
export function groundTable(): WebGLRenderTarget {
  return halfFloatTarget(lightSide, lightSide, LinearFilter);
}

function clear(renderer: WebGLRenderer, target: WebGLRenderTarget): void {
  target.viewport.set(0, 0, target.width, target.height);
  renderer.setRenderTarget(target);
  renderer.setClearColor(0x000000, 0);
  renderer.clear();
}
