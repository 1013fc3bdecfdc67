/** Draws a bundle under lights: onto a canvas, or into arrays. */

import {
  type DataTexture,
  HalfFloatType,
  PerspectiveCamera,
  RGBAFormat,
  Scene,
  UnsignedByteType,
  type WebGLRenderer,
  WebGLRenderTarget,
} from "three";
import { closePictures, type ShownBundle } from "../bundle/load.js";
import type { PreparedLight } from "../light/prepare.js";
import { ballOf } from "./ball.js";
import { groundHeight } from "./contact.js";
import { GraphicsFault } from "./fault.js";
import { FullScreen } from "./fullScreen.js";
import { IrradiancePasses } from "./irradiance.js";
import { Ground, groundUnder, hasGround } from "./ground.js";
import { groundLight } from "./groundLight.js";
import { StageLight } from "./light.js";
import type { Baked, Overlay } from "./overlay.js";
import { type LightTurn, type Look, type Method, type outputs, turnKey, type ViewCamera } from "./looks.js";
import { Resolve } from "./resolve.js";
import { Shading } from "./shading.js";
import { ShadowCaster } from "./shadowMaps.js";
import { maskTarget, Surface, sampleTarget } from "./surface.js";
import { fitting, halfFloatTarget } from "./targets.js";
import { aim } from "./projection.js";
import { rendererOn } from "./renderer.js";
import { cameraOfPart, type Part, partsOf, shareIn, tilesOf } from "./tiles.js";
import { BundleTextures, longestSide, splitSumTexture } from "./textures.js";
import { deviceFaults, fillIn } from "../words/words.js";

/** One half of the picture, or all of it. */
export type Side = {
  readonly light: string;
  readonly turn: LightTurn;
  readonly look: Look;
  readonly method: Method;
  /** Columns of the picture, as shares of its width. */
  readonly from: number;
  readonly to: number;
};

type Scenery = {
  readonly bundle: ShownBundle;
  readonly textures: BundleTextures;
  readonly passes: IrradiancePasses;
  readonly surface: Surface;
  readonly shading: Shading;
  readonly scene: Scene;
  readonly caster: ShadowCaster;
  ground: Ground | null;
};

const tileSide = 1024;

/** A canvas with a bundle and lights by name. */
export class Stage {
  readonly renderer: WebGLRenderer;
  readonly #screen: FullScreen;
  readonly #resolve = new Resolve();
  readonly #splitSum: DataTexture;
  readonly #camera = new PerspectiveCamera();
  readonly #lights = new Map<string, StageLight>();
  /** Whether pictures of 8 bits are dithered. */
  dither = true;
  /** Draws a finer picture in place of the baked one, where it has one. */
  overlay: Overlay | null = null;
  #radiance: WebGLRenderTarget | null = null;
  /** The finer picture's. */
  #finer: WebGLRenderTarget | null = null;
  #seen: WebGLRenderTarget | null = null;
  #mask: WebGLRenderTarget | null = null;
  /** Camera and samples that `#seen` holds. */
  #seenKey = "";
  #scenery: Scenery | null = null;

  /** Throws GraphicsFault where there is no WebGL2 or no target for radiance. */
  constructor(canvas: HTMLCanvasElement, splitSumTable: Float32Array<ArrayBuffer>) {
    this.renderer = rendererOn(canvas);
    this.#screen = new FullScreen(this.renderer);
    this.#splitSum = splitSumTexture(splitSumTable);
    Object.assign(this.#camera, { matrixAutoUpdate: false, matrixWorldAutoUpdate: false });
  }

  get bundle(): ShownBundle | null {
    return this.#scenery?.bundle ?? null;
  }

  /** Show another bundle; lights go with the one before. Throws GraphicsFault where its tables do not fit. */
  setBundle(bundle: ShownBundle): void {
    const { maxTextureSize } = this.renderer.capabilities;
    const longest = longestSide(bundle.transport);
    if (longest > maxTextureSize) {
      closePictures(bundle);
      throw new GraphicsFault(fillIn(deviceFaults.textureLimit, { most: maxTextureSize, needed: longest }));
    }
    const { transport, uncertainty, maps, mesh } = bundle;
    const textures = new BundleTextures(transport, uncertainty, maps, maxTextureSize);
    const surface = new Surface(mesh, textures);
    const shading = new Shading(bundle, textures, this.#splitSum);
    const scene = new Scene();
    scene.matrixWorldAutoUpdate = false;
    scene.add(surface.mesh);
    const passes = new IrradiancePasses(textures);
    // Programs are compiled and tables sent while the light is still being prepared. The bundle before goes in
    // between: its programs can be used again, and there is never memory for the tables of both.
    this.renderer.compile(scene, this.#camera);
    for (const each of [...passes.programs, shading.material, this.#resolve.material]) {
      this.#screen.compile(each);
    }
    this.#clear();
    const caster = new ShadowCaster(surface.mesh.geometry, ballOf(bundle.boundsMin, bundle.boundsMax));
    this.#scenery = { bundle, textures, passes, surface, shading, scene, caster, ground: null };
    for (const texture of textures.all) this.renderer.initTexture(texture);
    const gl = this.renderer.getContext();
    for (let error = gl.getError(); error !== gl.NO_ERROR; error = gl.getError()) {
      if (error !== gl.OUT_OF_MEMORY) continue;
      this.#clear();
      throw new GraphicsFault(deviceFaults.memory);
    }
  }

  /** Resolves when all of the bundle is on the stage; the first pictures may have to do with less. */
  async finished(): Promise<void> {
    if (await this.#scenery?.textures.fill(this.#scenery.bundle.finer)) this.restored();
  }

  /** Keep a light under a name, in place of the one before. */
  setLight(name: string, prepared: PreparedLight): void {
    if (this.#scenery === null) throw new Error("a light needs a bundle");
    this.#lights.get(name)?.dispose();
    this.#lights.set(name, new StageLight(prepared, this.#scenery.textures));
  }

  dropLight(name: string): void {
    this.#lights.get(name)?.dispose();
    this.#lights.delete(name);
  }

  light(name: string): StageLight | null {
    return this.#lights.get(name) ?? null;
  }

  /** Return a target that holds the surface at every sample of a picture, until something else is drawn. */
  samples(camera: ViewCamera, samples: number, ground: boolean): WebGLRenderTarget {
    if (this.#scenery === null) throw new Error("no bundle is open");
    this.#look(camera, samples, this.#scenery, ground);
    return this.#seen!;
  }

  /** Forget what was drawn before the context was lost. */
  restored(): void {
    for (const light of this.#lights.values()) {
      light.drawnTurn = null;
      light.drawnGround = null;
    }
    this.#scenery?.ground?.forget();
    this.#seenKey = "";
  }

  /** Draw onto the canvas, which takes the camera's size. */
  draw(camera: ViewCamera, sides: readonly Side[], samples: number): void {
    const canvas = this.renderer.domElement;
    if (canvas.width !== camera.width || canvas.height !== camera.height) {
      this.renderer.setSize(camera.width, camera.height, false);
    }
    this.renderer.setRenderTarget(null);
    this.renderer.setScissorTest(false);
    this.renderer.setClearColor(0x000000, 0);
    this.renderer.clear();
    const { width, height } = camera;
    for (const part of tilesOf(width, height, samples, this.renderer.capabilities.maxTextureSize)) {
      this.#drawPart(camera, part, sides, samples, null, "canvas");
    }
  }

  /** Return the picture as RGBA bytes, rows from the top, straight alpha. */
  readBytes(camera: ViewCamera, sides: readonly Side[], samples: number): Uint8ClampedArray<ArrayBuffer> {
    const result = new Uint8ClampedArray(4 * camera.width * camera.height);
    this.#tiles(camera, sides, samples, "straight", result);
    return result;
  }

  /** Return linear radiance as RGBA half floats, rows from the top, multiplied by alpha. */
  readHalf(camera: ViewCamera, sides: readonly Side[], samples: number): Uint16Array<ArrayBuffer> {
    const result = new Uint16Array(4 * camera.width * camera.height);
    this.#tiles(camera, sides, samples, "linear", result);
    return result;
  }

  dispose(): void {
    this.#clear();
    this.#radiance?.dispose();
    this.#finer?.dispose();
    this.#seen?.dispose();
    this.#mask?.dispose();
    this.#splitSum.dispose();
    this.#resolve.dispose();
    this.#screen.dispose();
    this.renderer.dispose();
  }

  #clear(): void {
    for (const name of [...this.#lights.keys()]) this.dropLight(name);
    this.#scenery?.ground?.dispose();
    this.#scenery?.caster.dispose();
    this.#scenery?.surface.dispose();
    this.#scenery?.shading.dispose();
    this.#scenery?.passes.dispose();
    this.#scenery?.textures.dispose();
    if (this.#scenery !== null) closePictures(this.#scenery.bundle);
    this.#scenery = null;
    this.#seen?.dispose();
    this.#seen = null;
    this.#seenKey = "";
  }

  /** Draw a picture of any size in tiles into an array, rows from the top. */
  #tiles(
    camera: ViewCamera,
    sides: readonly Side[],
    samples: number,
    output: "straight" | "linear",
    into: Uint8ClampedArray | Uint16Array,
  ): void {
    const type = output === "linear" ? HalfFloatType : UnsignedByteType;
    const side = Math.min(tileSide, Math.floor(this.renderer.capabilities.maxTextureSize / samples));
    for (const part of partsOf(camera.width, camera.height, side)) {
      const { left, top, width, height } = part;
      const target = new WebGLRenderTarget(width, height, { format: RGBAFormat, type, depthBuffer: false });
      this.#drawPart(camera, part, sides, samples, target, output);
      const count = 4 * width * height;
      const pixels = output === "linear" ? new Uint16Array(count) : new Uint8Array(count);
      this.renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
      target.dispose();
      for (let row = 0; row < height; row++) {
        const source = 4 * width * (height - 1 - row);
        const line = pixels.subarray(source, source + 4 * width);
        into.set(line, 4 * ((top + row) * camera.width + left));
      }
    }
  }

  /** Draw the sides of a part of a picture: into a target of its own, or where it is on the canvas. */
  #drawPart(
    camera: ViewCamera,
    part: Part,
    sides: readonly Side[],
    samples: number,
    target: WebGLRenderTarget | null,
    output: keyof typeof outputs,
  ): void {
    const tile = cameraOfPart(camera, part);
    const up = camera.height - part.top - part.height;
    const origin = target === null ? ([part.left, up] as const) : ([0, 0] as const);
    for (const side of sides) {
      const [from, to] = [shareIn(side.from, camera, part), shareIn(side.to, camera, part)];
      if (to > from) this.#drawSide(tile, { ...side, from, to }, samples, target, output, origin);
    }
  }

  #drawSide(
    camera: ViewCamera,
    side: Side,
    samples: number,
    target: WebGLRenderTarget | null,
    output: keyof typeof outputs,
    origin: readonly [number, number],
  ): void {
    const light = this.#lights.get(side.light);
    const scenery = this.#scenery;
    if (light === undefined || scenery === null) return;
    const { turn } = side;
    const key = turnKey(turn);
    const needed = side.method === "baked" || side.look.channel === "visibility";
    if (light.drawnTurn !== key && needed) {
      this.renderer.setScissorTest(false);
      scenery.passes.draw(this.#screen, light.falling(turn), light.tables);
      if (light.shadows !== null) scenery.caster.draw(this.renderer, light.cast(turn), light.shadows);
      light.drawnTurn = key;
    }
    const { width, height } = camera;
    this.#look(camera, samples, scenery, hasGround(side));
    this.#radiance = fitting(this.#radiance, width, height, halfFloatTarget);
    const columns = [Math.round(side.from * width), Math.round(side.to * width)] as const;
    scenery.shading.light(side.look, side.method, light, turn, scenery.caster);
    this.#scissor(this.#radiance, columns, height);
    this.#screen.draw(scenery.shading.material, this.#radiance);
    const finer = side.light === "a" && side.method === "baked" ? this.overlay : null;
    const isFiner = finer?.shows(camera, side.look) ?? false;
    if (isFiner) {
      this.#finer = fitting(this.#finer, width, height, halfFloatTarget);
      this.#scissor(this.#finer, columns, height);
      finer!.draw(this.#screen, camera, side.look, this.#baked(samples, target === null), this.#finer);
    }
    const ground = this.#ground(side, light, samples > 1 || target !== null, scenery);
    const picture = (isFiner ? this.#finer! : this.#radiance).texture;
    this.#resolve.prepare({
      ...{ picture, camera, look: side.look, light, turn, target: output, ground, origin },
      dither: this.dither,
    });
    this.#scissor(target, columns, height, origin);
    if (target === null) this.renderer.setViewport(...origin, width, height);
    this.#screen.draw(this.#resolve.material, target);
    this.#scissor(null, null, 0);
  }

  /** Return what was drawn last, with its samples. */
  #baked(samples: number, live: boolean): Baked {
    const [seen, facing] = this.#seen!.textures;
    const mask = samples === 1 ? this.#mask!.texture : null;
    return { radiance: this.#radiance!.texture, seen: seen!, facing: facing!, mask, samples, live };
  }

  /** Draw the shadow on the ground if it is enabled; returns the ground, or null. */
  #ground({ look, method, turn }: Side, light: StageLight, still: boolean, scenery: Scenery) {
    if (!hasGround({ look, method })) return null;
    const { boundsMin, boundsMax } = scenery.bundle;
    scenery.ground ??= new Ground(
      scenery.surface.mesh.geometry,
      groundUnder(boundsMin, boundsMax, groundHeight(scenery.bundle)),
    );
    const key = turnKey(turn);
    const known = [`${key} still`, `${key} ${still ? "still" : "moving"}`];
    if (!scenery.ground.isWhole || !known.includes(light.drawnGround ?? "")) {
      const falling = light.falling(turn);
      const discs = light.cast(turn);
      this.renderer.setScissorTest(false);
      scenery.ground.draw(this.renderer, this.#screen, groundLight(falling), discs, light.ground, still);
      light.drawnGround = `${key} ${still ? "still" : "moving"}`;
    }
    return scenery.ground.place;
  }

  /** Draw the surface at every sample, unless that is known. */
  #look(camera: ViewCamera, samples: number, scenery: Scenery, ground: boolean): void {
    // From below there is no ground.
    const height = ground ? groundHeight(scenery.bundle) : Number.POSITIVE_INFINITY;
    const floor = camera.cameraToWorld[11]! > height ? height : null;
    scenery.surface.floor = floor;
    const key = `${floor} ${samples} ${Object.values(camera).flat().join(" ")}`;
    if (this.#seenKey === key) return;
    const depthRange = aim(this.#camera, camera, scenery.bundle);
    this.#seen = fitting(this.#seen, camera.width * samples, camera.height * samples, sampleTarget);
    this.renderer.setRenderTarget(this.#seen);
    this.renderer.setClearColor(0x000000, 0);
    this.renderer.clear();
    this.renderer.render(scenery.scene, this.#camera);
    if (samples === 1) this.#drawMask(camera, scenery);
    const mask = samples === 1 ? this.#mask!.texture : null;
    scenery.shading.aim([...this.#seen.textures, mask], samples, camera, depthRange);
    this.#seenKey = key;
  }

  /** Draw how much of every pixel the mesh covers, for pictures with one sample to a pixel. */
  #drawMask({ width, height }: ViewCamera, { scene, surface }: Scenery): void {
    this.#mask = fitting(this.#mask, width, height, maskTarget);
    this.renderer.setRenderTarget(this.#mask);
    this.renderer.clear();
    const { mesh } = surface;
    mesh.material = surface.mask;
    this.renderer.render(scene, this.#camera);
    mesh.material = surface.program;
  }

  #scissor(
    target: WebGLRenderTarget | null,
    columns: readonly number[] | null,
    height: number,
    [x, y]: readonly [number, number] = [0, 0],
  ): void {
    const on = columns !== null;
    const [from, to] = columns ?? [0, 0];
    if (target === null) {
      this.renderer.setScissorTest(on);
      if (on) this.renderer.setScissor(x + from!, y, to! - from!, height);
    } else {
      target.scissorTest = on;
      target.scissor.set(from!, 0, to! - from!, height);
    }
  }
}
