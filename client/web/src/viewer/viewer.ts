/** A bundle on a canvas under lights: redraws on changes, and prepares light in a worker. */

import { loadBeside } from "../bundle/client.js";
import type { BundleNews, ShownBundle } from "../bundle/load.js";
import { type BundleOrigin, secretOf } from "../bundle/source.js";
import { bundleAt } from "../page/addresses.js";
import type { Direction } from "../engine/environment.js";
import { exposureFor } from "../light/exposure.js";
import { MapFault } from "../page/fault.js";
import type { RefinedPicture } from "../refine/accumulation.js";
import type { Refinement } from "../refine/refinement.js";
import type { StillHost } from "../refine/still.js";
import { notRefining, type RefineOptions, refineOptions } from "../refine/status.js";
import { type Ball, ballOf } from "../render/ball.js";
import type { LightTurn, Rgb, ViewCamera } from "../render/looks.js";
import { Stage } from "../render/stage.js";
import { beside, type Inset, noInset, orbitCamera, photoCamera, sizeOf } from "./camera.js";
import { Emitter, type ViewerEvents } from "./events.js";
import { elevationRange, firstView, inAnotherLight } from "./firstView.js";
import { type Frozen, freeze, sidesOf } from "./frozen.js";
import { ViewerLights } from "./lights.js";
import { besidePhotograph } from "./photograph.js";
import { initialState, limits, type OrbitPose, type ViewerState } from "./state.js";
import { Stills } from "./stills.js";
import { mainDirection, turnedFor } from "./turning.js";
import { fillIn, texts } from "../words/words.js";

const stillSamples = 2;
const stillAfterMs = 150;

/** Draws one bundle. */
export class Viewer {
  readonly #events = new Emitter();
  /** Its lights, and the maps that were dropped. */
  readonly lights = new ViewerLights({
    stage: () => this.#stage,
    state: () => this.#state,
    lit: (notes) => {
      this.#stills.lose();
      if (notes.length > 0) this.#tell("message", notes.join(" "), false);
      this.invalidate();
    },
  });
  #state: ViewerState = initialState;
  #stage: Stage | null = null;
  #ball: Ball = { centre: [0, 0, 0], radius: 1 };
  #loading: AbortController | null = null;
  #frame = 0;
  #still = 0;
  #moving = false;
  #inset = noInset;
  #photoEdge: Rgb | null = null;
  #source: BundleOrigin | null = null;
  #refinement: Refinement | null = null;
  readonly #stills = new Stills();
  #closed = false;
  /** The pose that a bundle is opened with, unless another one was chosen. */
  home: OrbitPose = initialState.pose;
  /** The turn of a built-in light until someone turns it. */
  homeTurn: LightTurn = initialState.turn;
  #refineOptions: RefineOptions = refineOptions;

  constructor(readonly canvas: HTMLCanvasElement) {
    canvas.addEventListener("webglcontextlost", (event) => {
      if (this.#closed) return;
      event.preventDefault();
      this.#stills.lose();
      this.#tell("message", texts.viewer.graphicsLost, true);
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.#stage?.restored();
      this.#tell("message", "", false);
      this.invalidate();
    });
  }

  /** The bundle that is shown, or null. */
  get bundle(): ShownBundle | null {
    return this.#stage?.bundle ?? null;
  }

  /** The sphere around the bundle that is shown. */
  get ball(): Ball {
    return this.#ball;
  }

  /** The id of the bundle that is shown, where it is one of our own on the server that the page came from; else null. */
  get serverBundle(): string | null {
    if (this.bundle === null || this.#source?.kind !== "url" || secretOf(this.#source.url)) return null;
    return bundleAt(this.#source.url, document.baseURI);
  }

  /** Where the bundle that is shown comes from, or null. */
  get source(): BundleOrigin | null {
    return this.bundle === null ? null : this.#source;
  }

  get state(): ViewerState {
    return this.#state;
  }

  /** Call `listener` whenever `name` happens; returns what stops it. */
  on<N extends keyof ViewerEvents>(name: N, listener: ViewerEvents[N]): () => void {
    return this.#events.on(name, listener);
  }

  /** Read and show a bundle. Throws BundleFault or GraphicsFault; a newer call gives up this one. */
  async open(origin: BundleOrigin): Promise<void> {
    this.#loading?.abort(new DOMException("another bundle was opened", "AbortError"));
    const loading = new AbortController();
    this.#loading = loading;
    const early = this.lights.early();
    const hear = (news: BundleNews): void => {
      if (news.kind === "progress") {
        this.#tell("progress", news.readBytes, news.totalBytes);
        return;
      }
      if (news.kind === "opened") {
        this.#tell("opened", news.name);
        this.#tell("progress", 0, news.totalBytes);
      }
      early.hear(news);
    };
    const bundle = await loadBeside(this.#setStage(loading.signal), origin, hear, loading.signal);
    this.#stills.lose();
    // Its workers hold what they need of the bundle that goes.
    this.#endRefining();
    this.#stage!.setBundle(bundle);
    this.#source = origin;
    this.lights.forget(early);
    this.#ball = ballOf(bundle.boundsMin, bundle.boundsMax);
    const first = firstView(this.#state, this, bundle, sizeOf(this.canvas));
    [this.home, this.homeTurn, this.#state] = [first.home, first.homeTurn, first.state];
    this.#keepRefined();
    let trouble: MapFault | null = null;
    try {
      await this.lights.apply();
    } catch (error) {
      // Ignore errors of a bundle that is no longer shown.
      loading.signal.throwIfAborted();
      if (!(error instanceof MapFault)) throw error;
      trouble = error;
      this.#state = inAnotherLight(this.#state, bundle, this.homeTurn);
      await this.lights.apply();
    }
    loading.signal.throwIfAborted();
    this.#tell("load", bundle);
    this.#tell("change");
    if (trouble !== null) this.#tell("message", trouble.message, true);
    this.invalidate();
    await this.#stage!.finished();
    this.invalidate();
  }

  /** Change the state. Throws MapFault where a new light cannot be used; the state then stays as it was. */
  async update(change: Partial<ViewerState>): Promise<void> {
    const before = this.#state;
    const asked = { ...before, ...turnedFor(change, before, this.homeTurn) };
    this.#state = asked;
    this.invalidate();
    try {
      await this.lights.apply();
    } catch (error) {
      // Settings changed in the meantime are kept.
      const now = this.#state;
      const kept = (name: "environment" | "environmentB"): string =>
        now[name] === asked[name] ? before[name] : now[name];
      const turn = now.turn === asked.turn ? before.turn : now.turn;
      this.#state = { ...now, turn, environment: kept("environment"), environmentB: kept("environmentB") };
      this.#tell("change");
      throw error;
    }
    this.#tell("change");
  }

  /** Whether someone moves something now: pictures are then drawn with one sample per pixel. */
  set moving(on: boolean) {
    this.#moving = on;
    this.invalidate();
  }

  /** Whether pictures of 8 bits are dithered, so that gradients have no bands. */
  set dither(on: boolean) {
    this.#ready().dither = on;
    this.invalidate();
  }

  /** Draw again, soon. */
  invalidate(): void {
    clearTimeout(this.#still);
    this.#keepRefined();
    if (this.#frame === 0) this.#frame = requestAnimationFrame(() => this.#drawNow());
  }

  /** Return the camera for a picture of some size. */
  camera(width: number, height: number, state = this.#state): ViewCamera {
    const photo = this.photoCamera(state);
    return photo ? photoCamera(photo, width, height) : orbitCamera(state.pose, this.#ball, width, height);
  }

  /** The camera of the picture on the canvas, or on one of another size that is like it. */
  canvasCamera({ width, height } = sizeOf(this.canvas)): ViewCamera {
    return beside(this.#inset, width, height, (...size) => this.camera(...size));
  }

  /** What covers the canvas; the object is in the middle of the rest. */
  set inset(inset: Inset) {
    if (Object.entries(inset).every(([edge, share]) => this.#inset[edge as keyof Inset] === share)) return;
    this.#inset = inset;
    this.invalidate();
  }

  /** Return the camera of the photograph that is compared with, or null. */
  photoCamera({ compare, photo } = this.#state) {
    if (compare !== "photo") return null;
    return this.bundle?.cameras.find((camera) => camera.name === photo) ?? null;
  }

  /** Return the view as RGBA bytes, straight alpha, sRGB-encoded, rows from the top. */
  pixels(width: number, height: number, samples = stillSamples): Uint8ClampedArray<ArrayBuffer> {
    return this.#ready().readBytes(
      this.camera(width, height),
      sidesOf(this.#drawn(), this.homeTurn),
      samples,
    );
  }

  /** Return the view of a camera as RGBA bytes; see `pixels`. */
  pixelsOf(camera: ViewCamera, samples = stillSamples): Uint8ClampedArray<ArrayBuffer> {
    return this.#ready().readBytes(camera, sidesOf(this.#drawn(), this.homeTurn), samples);
  }

  /**
   * Return what draws a state with changes of camera, turn and look, as `pixels` does, without showing it. That throws
   * `film.interrupted` where another bundle or light is shown by then, or the graphics card is gone.
   */
  frozen(state: ViewerState): Frozen {
    const cameraOf = (width: number, height: number, now: ViewerState) => this.camera(width, height, now);
    return freeze(this.#ready(), cameraOf, () => this.#closed, this.#drawn(state));
  }

  /** Return linear radiance, RGBA half floats multiplied by alpha, rows from the top. */
  radiance(width: number, height: number, samples = stillSamples): Uint16Array<ArrayBuffer> {
    return this.#ready().readHalf(this.camera(width, height), sidesOf(this.#drawn(), this.homeTurn), samples);
  }

  /** The refined picture that is shown in place of the baked one, or null. */
  get refined(): RefinedPicture | null {
    return this.#refinement?.shown?.picture ?? null;
  }

  /** When refining stops, and its backend: another one begins anew. */
  get refineOptions(): RefineOptions {
    return this.#refineOptions;
  }

  set refineOptions(options: RefineOptions) {
    this.#refineOptions = options;
    this.#tell("change");
    this.invalidate();
  }

  /** Stop refining what is shown, and return what refines a picture of any size; its `end` resumes. */
  refineElsewhere(): StillHost & { readonly end: () => void } {
    this.#endRefining();
    return {
      ...{ stage: this.#ready(), view: this.#refineView() },
      sides: sidesOf(this.#drawn(), this.homeTurn),
      ...this.#stills.begin(() => this.invalidate()),
    };
  }

  /** The elevations to look from, degrees. */
  get elevationRange(): readonly [number, number] {
    return this.bundle === null || this.#state.free ? limits.elevation : elevationRange(this.bundle);
  }

  /** Draw onto the canvas at once. */
  drawNow(samples = 1): void {
    this.#ready().draw(this.canvasCamera(), sidesOf(this.#drawn(), this.homeTurn), samples);
    this.#tell("draw");
  }

  /** The exposure that the light decides, in EV; 0 without a light. */
  get lightExposure(): number {
    const prepared = this.#stage?.light("a")?.prepared;
    return prepared === undefined ? 0 : exposureFor(prepared, mainDirection(prepared));
  }

  /** The colour behind the photograph that is compared with, sRGB 0 to 1, or null where it has more than one. */
  set photoEdge(edge: Rgb | null) {
    this.#photoEdge = edge;
    this.invalidate();
  }

  /** Where the main light of the picture comes from, as the map has it; null where it has no direction, or none is there. */
  get mainLight(): Direction | null {
    const prepared = this.#stage?.light("a")?.prepared;
    return prepared === undefined ? null : mainDirection(prepared);
  }

  /** Counts of what lies on the graphics card. */
  get memory(): { readonly geometries: number; readonly textures: number; readonly programs: number } {
    const { memory, programs } = this.#ready().renderer.info;
    return { ...memory, programs: programs?.length ?? 0 };
  }

  dispose(): void {
    this.#closed = true;
    this.#stills.lose();
    this.#refinement?.dispose();
    this.#loading?.abort(new DOMException("the viewer was closed", "AbortError"));
    cancelAnimationFrame(this.#frame);
    clearTimeout(this.#still);
    this.#events.clear();
    this.#stage?.dispose();
    // Browsers keep few contexts, and would take one away from another picture.
    this.#stage?.renderer.forceContextLoss();
    this.lights.dispose();
  }

  /** Make what draws, while a bundle is being read. */
  async #setStage(signal: AbortSignal): Promise<void> {
    if (this.#stage !== null) return;
    const table = await this.lights.splitSum();
    if (!signal.aborted) this.#stage ??= new Stage(this.canvas, table);
  }

  /** Return a state as it is drawn: exposed for the light on the left, and beside a photograph as that is. */
  #drawn(state = this.#state): ViewerState {
    const besides = this.photoCamera(state) !== null;
    const look = besides ? besidePhotograph(state.look, this.#photoEdge) : state.look;
    const exposureEv = look.exposureEv + (look.autoExposure ? this.lightExposure : 0);
    return { ...state, look: { ...look, exposureEv } };
  }

  #ready(): Stage {
    if (this.#stage?.bundle == null) throw new Error("no bundle is open");
    return this.#stage;
  }

  #tell<N extends keyof ViewerEvents>(name: N, ...values: Parameters<ViewerEvents[N]>): void {
    this.#events.tell(name, ...values);
  }

  #drawNow(samples = 1): void {
    this.#frame = 0;
    if (this.#stage?.bundle == null) return;
    this.drawNow(samples);
    if (samples === 1 && !this.#moving) {
      this.#still = setTimeout(() => this.#drawNow(stillSamples), stillAfterMs) as unknown as number;
    } else if (samples > 1) this.#refineSoon();
  }

  #endRefining(): void {
    this.#refinement?.dispose();
    this.#refinement = null;
  }

  /** Take a refined picture away that is no longer what should be shown. */
  #keepRefined(): void {
    if (this.#stage?.bundle == null || this.#refinement === null) return;
    if (this.#state.refine) {
      this.#refinement.changed();
      return;
    }
    this.#endRefining();
    this.#tell("refine", notRefining);
  }

  /** The picture at rest was drawn: refine it, if that is wanted. What that needs is fetched now. */
  #refineSoon(): void {
    // Both would draw in place of the baked picture, and share the processors.
    if (!this.#state.refine || this.#stills.isAny) return;
    if (this.#refinement !== null) {
      this.#refinement.rest();
      return;
    }
    Promise.all([import("../refine/refinement.js"), this.bundle?.finer])
      .then(([{ Refinement }]) => {
        const given = this.#closed || this.#stills.isAny || this.#refinement !== null;
        if (given || !this.#state.refine) return;
        this.#refinement = new Refinement({
          stage: this.#ready(),
          view: () => this.#refineView(),
          redraw: () => this.#drawNow(stillSamples),
          fades: true,
          tell: (status) => this.#tell("refine", status),
        });
        this.#refinement.changed();
        this.#refinement.rest();
      })
      .catch((why) => this.#tell("message", fillIn(texts.refine.failed, { why }), true));
  }

  #refineView() {
    const { turn, look } = this.#state;
    return {
      bundle: this.bundle!,
      origin: this.#source!,
      camera: this.canvasCamera(),
      turn,
      look,
      moving: this.#moving,
      options: this.refineOptions,
    };
  }
}
