/** A bundle on a canvas under lights: redraws on changes, and prepares light in a worker. */

import { loadInWorker } from "../bundle/client.js";
import type { BundleNews, LoadedBundle } from "../bundle/load.js";
import type { BundleOrigin } from "../bundle/source.js";
import { bundleAt } from "../page/addresses.js";
import { LightClient } from "../light/client.js";
import { maxDominant } from "../light/prepare.js";
import { MapFault } from "../light/fault.js";
import type { RefinedPicture } from "../refine/accumulation.js";
import type { Refinement } from "../refine/refinement.js";
import { notRefining, type RefineOptions, type RefineStatus, refineOptions } from "../refine/status.js";
import { type Ball, ballOf } from "../render/ball.js";
import type { ViewCamera } from "../render/looks.js";
import { type Side, Stage } from "../render/stage.js";
import { orbitCamera, photoCamera } from "./camera.js";
import { EarlyLight, lightFor } from "./earlyLight.js";
import { elevationRange, firstPose } from "./firstView.js";
import { mapOrigin } from "./mapOrigin.js";
import { initialState, limits, type OrbitPose, type ViewerState } from "./state.js";

/** The events of a viewer. */
export type ViewerEvents = {
  /** The state is another one. */
  readonly change: () => void;
  /** A bundle is being read; share from 0 to 1. */
  readonly progress: (share: number) => void;
  /** A bundle is shown. */
  readonly load: (bundle: LoadedBundle) => void;
  /** A picture was drawn. */
  readonly draw: () => void;
  /** Refining came further, or to an end. */
  readonly refine: (status: RefineStatus) => void;
  /** Something to tell; `problem` where it went wrong. */
  readonly message: (text: string, problem: boolean) => void;
};

const stillSamples = 2;
const stillAfterMs = 150;
const maxPixelRatio = 2;

/** Draws one bundle. */
export class Viewer {
  readonly #listeners = new Map<keyof ViewerEvents, Set<(...values: never[]) => void>>();
  readonly #lights = new LightClient();
  readonly #files = new Map<string, Uint8Array<ArrayBuffer>>();
  readonly #shown = new Map<"a" | "b", string>();
  #state: ViewerState = initialState;
  #stage: Stage | null = null;
  #ball: Ball = { centre: [0, 0, 0], radius: 1 };
  #loading: AbortController | null = null;
  #early: EarlyLight | null = null;
  #frame = 0;
  #still = 0;
  #moving = false;
  #source: BundleOrigin | null = null;
  #refinement: Refinement | null = null;
  #closed = false;
  /** The pose that a bundle is opened with, unless another one was chosen. */
  home: OrbitPose = initialState.pose;
  /** When refining stops, and its backend. */
  refineOptions: RefineOptions = refineOptions;

  constructor(readonly canvas: HTMLCanvasElement) {
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.#tell("message", "The graphics card was taken away; waiting for it to come back.", true);
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.#stage?.restored();
      this.#tell("message", "", false);
      this.invalidate();
    });
  }

  /** The bundle that is shown, or null. */
  get bundle(): LoadedBundle | null {
    return this.#stage?.bundle ?? null;
  }

  /** The id of the bundle that is shown, where it is one of the server that the page came from; else null. */
  get serverBundle(): string | null {
    if (this.bundle === null || this.#source?.kind !== "url") return null;
    return bundleAt(this.#source.url, document.baseURI);
  }

  /** The current state. */
  get state(): ViewerState {
    return this.#state;
  }

  /** Call `listener` whenever `name` happens; returns what stops it. */
  on<N extends keyof ViewerEvents>(name: N, listener: ViewerEvents[N]): () => void {
    const all = this.#listeners.get(name) ?? new Set();
    this.#listeners.set(name, all);
    all.add(listener);
    return () => all.delete(listener);
  }

  /** Read and show a bundle. Throws BundleFault or GraphicsFault; a newer call gives up this one. */
  async open(origin: BundleOrigin): Promise<void> {
    this.#loading?.abort(new DOMException("another bundle was opened", "AbortError"));
    const loading = new AbortController();
    this.#loading = loading;
    const early = new EarlyLight({
      wanted: () => this.#state.environment,
      originOf: (name) => mapOrigin(name, this.bundle, this.#files),
      prepare: (origin, bands) => this.#lights.prepare(origin, bands, maxDominant),
    });
    const hear = (news: BundleNews): void => {
      if (news.kind === "progress") this.#tell("progress", news.readBytes / Math.max(news.totalBytes, 1));
      else early.hear(news);
    };
    const [bundle] = await Promise.all([
      loadInWorker(origin, hear, loading.signal),
      this.#setStage(loading.signal),
    ]);
    loading.signal.throwIfAborted();
    this.#early = early;
    this.#stage!.setBundle(bundle);
    this.#source = origin;
    this.#shown.clear();
    this.#ball = ballOf(bundle.boundsMin, bundle.boundsMax);
    const trained = bundle.trainedMaps.map(({ name }) => name);
    const { pose } = this.#state;
    const { width, height } = this.#size();
    const before = this.home;
    this.home = firstPose(bundle, width, height);
    this.#state = {
      ...this.#state,
      environment: lightFor(this.#state.environment, trained),
      // Where neither a link nor a person has chosen another.
      pose: pose === before ? this.home : pose,
    };
    this.#keepRefined();
    let trouble: MapFault | null = null;
    try {
      await this.#applyLights();
    } catch (error) {
      if (!(error instanceof MapFault)) throw error;
      // A link may name a map that is gone: the object is shown all the same, in a light that is there.
      trouble = error;
      const light = lightFor("", trained);
      this.#state = { ...this.#state, environment: light, environmentB: light };
      await this.#applyLights();
    }
    this.#tell("load", bundle);
    this.#tell("change");
    if (trouble !== null) this.#tell("message", trouble.message, true);
    this.invalidate();
  }

  /** Change the state. Throws MapFault where a new light cannot be used; the state then stays as it was. */
  async update(change: Partial<ViewerState>): Promise<void> {
    const before = this.#state;
    const asked = { ...before, ...change };
    this.#state = asked;
    this.invalidate();
    try {
      await this.#applyLights();
    } catch (error) {
      // Settings changed in the meantime are kept.
      const now = this.#state;
      const kept = (name: "environment" | "environmentB"): string =>
        now[name] === asked[name] ? before[name] : now[name];
      this.#state = { ...now, environment: kept("environment"), environmentB: kept("environmentB") };
      this.#tell("change");
      throw error;
    }
    this.#tell("change");
  }

  /** Keep a dropped map and return the name it has from now on. */
  addMap(name: string, data: Uint8Array<ArrayBuffer>): string {
    this.#files.set(name, data);
    // A map that was changed on disk and dropped again is another one.
    for (const [slot, shown] of this.#shown) if (shown === `file:${name}`) this.#shown.delete(slot);
    return `file:${name}`;
  }

  /** Names of maps that were dropped. */
  get mapNames(): string[] {
    return [...this.#files.keys()];
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
  camera(width: number, height: number): ViewCamera {
    const photo = this.photoCamera();
    return photo
      ? photoCamera(photo, width, height)
      : orbitCamera(this.#state.pose, this.#ball, width, height);
  }

  /** Return the camera of the photograph that is compared with, or null. */
  photoCamera() {
    if (this.#state.compare !== "photo") return null;
    return this.bundle?.cameras.find((camera) => camera.name === this.#state.photo) ?? null;
  }

  /** Return the view as RGBA bytes, straight alpha, sRGB-encoded, rows from the top. */
  pixels(width: number, height: number, samples = stillSamples): Uint8ClampedArray<ArrayBuffer> {
    return this.#ready().readBytes(this.camera(width, height), this.#sides(), samples);
  }

  /** Return the view of a camera as RGBA bytes; see `pixels`. */
  pixelsOf(camera: ViewCamera, samples = stillSamples): Uint8ClampedArray<ArrayBuffer> {
    return this.#ready().readBytes(camera, this.#sides(), samples);
  }

  /** Return linear radiance, RGBA half floats multiplied by alpha, rows from the top. */
  radiance(width: number, height: number, samples = stillSamples): Uint16Array<ArrayBuffer> {
    return this.#ready().readHalf(this.camera(width, height), this.#sides(), samples);
  }

  /** The refined picture that is shown in place of the baked one, or null. */
  get refined(): RefinedPicture | null {
    return this.#refinement?.shown?.picture ?? null;
  }

  /** The camera of that picture on the canvas, or null. */
  get refinedCamera(): ViewCamera | null {
    return this.#refinement?.shown?.camera ?? null;
  }

  /** The elevations to look from, degrees. */
  get elevationRange(): readonly [number, number] {
    return this.bundle === null || this.#state.free ? limits.elevation : elevationRange(this.bundle);
  }

  /** Draw onto the canvas at once. */
  drawNow(samples = 1): void {
    const { width, height } = this.#size();
    this.#ready().draw(this.camera(width, height), this.#sides(), samples);
    this.#tell("draw");
  }

  /** Counts of what lies on the graphics card. */
  get memory(): { readonly geometries: number; readonly textures: number; readonly programs: number } {
    const { memory, programs } = this.#ready().renderer.info;
    return { ...memory, programs: programs?.length ?? 0 };
  }

  dispose(): void {
    this.#closed = true;
    this.#refinement?.dispose();
    this.#loading?.abort(new DOMException("the viewer was closed", "AbortError"));
    cancelAnimationFrame(this.#frame);
    clearTimeout(this.#still);
    this.#stage?.dispose();
    this.#lights.dispose();
    this.#listeners.clear();
  }

  /** Make what draws, while a bundle is being read. */
  async #setStage(signal: AbortSignal): Promise<void> {
    if (this.#stage !== null) return;
    const table = await this.#lights.splitSum();
    if (!signal.aborted) this.#stage ??= new Stage(this.canvas, table);
  }

  #ready(): Stage {
    if (this.#stage?.bundle == null) throw new Error("no bundle is open");
    return this.#stage;
  }

  #tell<N extends keyof ViewerEvents>(name: N, ...values: Parameters<ViewerEvents[N]>): void {
    for (const listener of this.#listeners.get(name) ?? []) {
      (listener as (...values: Parameters<ViewerEvents[N]>) => void)(...values);
    }
  }

  #size(): { width: number; height: number } {
    const ratio = Math.min(globalThis.devicePixelRatio || 1, maxPixelRatio);
    const side = (css: number): number => Math.max(1, Math.round(css * ratio));
    return { width: side(this.canvas.clientWidth), height: side(this.canvas.clientHeight) };
  }

  #drawNow(samples = 1): void {
    this.#frame = 0;
    if (this.#stage?.bundle == null) return;
    this.drawNow(samples);
    if (samples === 1 && !this.#moving) {
      this.#still = setTimeout(() => this.#drawNow(stillSamples), stillAfterMs) as unknown as number;
    } else if (samples > 1) this.#refineSoon();
  }

  /** Take a refined picture away that is no longer what should be shown. */
  #keepRefined(): void {
    if (this.#stage?.bundle == null || this.#refinement === null) return;
    if (this.#state.refine) {
      this.#refinement.changed();
      return;
    }
    this.#refinement.dispose();
    this.#refinement = null;
    this.#tell("refine", notRefining);
  }

  /** The picture at rest was drawn: refine it, if that is wanted. What that needs is fetched now. */
  #refineSoon(): void {
    if (!this.#state.refine) return;
    if (this.#refinement !== null) {
      this.#refinement.rest();
      return;
    }
    import("../refine/refinement.js")
      .then(({ Refinement }) => {
        if (this.#closed || !this.#state.refine || this.#refinement !== null) return;
        this.#refinement = new Refinement({
          stage: this.#ready(),
          view: () => this.#refineView(),
          redraw: () => this.#drawNow(stillSamples),
          tell: (status) => this.#tell("refine", status),
        });
        this.#refinement.changed();
        this.#refinement.rest();
      })
      .catch((error: unknown) => this.#tell("message", `Cannot refine: ${String(error)}`, true));
  }

  #refineView() {
    const { width, height } = this.#size();
    const { turn, look } = this.#state;
    return {
      bundle: this.bundle!,
      origin: this.#source!,
      camera: this.camera(width, height),
      cameraOf: (w: number, h: number) => this.camera(w, h),
      turn,
      look,
      moving: this.#moving,
      options: this.refineOptions,
    };
  }

  #sides(): Side[] {
    const { turn, look, compare, split } = this.#state;
    const whole: Side = { light: "a", turn, look, method: "baked", from: 0, to: 1 };
    if (compare !== "environment" && compare !== "plain") return [whole];
    const other = compare === "environment" ? ({ light: "b" } as const) : ({ method: "plain" } as const);
    return [
      { ...whole, to: split },
      { ...whole, ...other, from: split },
    ];
  }

  /** Prepare the lights that the state names and that are not there yet. */
  async #applyLights(): Promise<void> {
    const { environment, environmentB, compare } = this.#state;
    const wanted: ["a" | "b", string][] = [["a", environment]];
    if (compare === "environment") wanted.push(["b", environmentB]);
    else {
      this.#stage?.dropLight("b");
      this.#shown.delete("b");
    }
    await Promise.all(
      wanted.map(async ([slot, name]) => {
        const stage = this.#stage;
        const bundle = stage?.bundle;
        if (stage == null || bundle == null || this.#shown.get(slot) === name) return;
        this.#shown.set(slot, name);
        const { bands } = bundle.transport.direct;
        try {
          const prepared = await (this.#early?.take(name, bands) ??
            this.#lights.prepare(mapOrigin(name, this.bundle, this.#files), bands, maxDominant));
          // Another light may have been chosen, or another bundle opened, in the meantime.
          if (this.#shown.get(slot) !== name || stage.bundle !== bundle) return;
          stage.setLight(slot, prepared);
          if (prepared.notes.length > 0) this.#tell("message", prepared.notes.join(" "), false);
          this.invalidate();
        } catch (error) {
          // Ignore errors of a light that is no longer wanted.
          if (this.#shown.get(slot) !== name) return;
          this.#shown.delete(slot);
          throw error;
        }
      }),
    );
  }
}
