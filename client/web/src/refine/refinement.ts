/**
 * Refines the picture of a viewer while nothing moves, and removes the refined picture when something does.
 */

import type { LoadedBundle } from "../bundle/load.js";
import type { BundleOrigin } from "../bundle/source.js";
import type { PreparedLight } from "../light/prepare.js";
import { hasGround } from "../render/ground.js";
import { turnMatrix } from "../render/light.js";
import type { LightTurn, Look, ViewCamera } from "../render/looks.js";
import type { Stage } from "../render/stage.js";
import type { RefinedPicture } from "./accumulation.js";
import type { RefineAnswer } from "./messages.js";
import { mostPoints, planOf, resized } from "./plan.js";
import { RefinePool, workersFor } from "./pool.js";
import { RefinedLayer } from "./refinedLayer.js";
import { notRefining, refinedChannels, type RefineOptions, type RefineStatus } from "./status.js";
import { readSamples } from "./surfaceReader.js";

/** The current picture. */
export type RefineView = {
  readonly bundle: LoadedBundle;
  readonly origin: BundleOrigin;
  /** Of the picture on the canvas. */
  readonly camera: ViewCamera;
  readonly turn: LightTurn;
  readonly look: Look;
  readonly moving: boolean;
  readonly options: RefineOptions;
};

/** The parts of a viewer that a refinement uses. */
export type RefineHost = {
  readonly stage: Stage;
  readonly view: () => RefineView;
  readonly redraw: () => void;
  /** Whether someone looks on as the refined picture comes in. */
  readonly fades: boolean;
  readonly tell: (status: RefineStatus) => void;
};

const restMs = 350;
const coarseSide = 256;
/** How long the refined picture takes to come in place of the baked one. */
const fadeMs = 400;

/** One viewer's refinement. */
export class Refinement {
  #status: RefineStatus = notRefining;
  #pool: RefinePool | null = null;
  #opened: Extract<RefineAnswer, { kind: "opened" }> | null = null;
  /** The workers are for this bundle, and for this backend. */
  #bundle: LoadedBundle | null = null;
  #backend: RefineOptions["backend"] | null = null;
  #sentLight: PreparedLight["levels"] | null = null;
  #layer: RefinedLayer | null = null;
  #picture: RefinedPicture | null = null;
  /** The current or next task. */
  #key = "";
  #light: PreparedLight | null = null;
  #id = 0;
  #rest = 0;
  #frame = 0;

  constructor(private readonly host: RefineHost) {}

  /** The picture that is shown in place of the baked one, and the camera that saw it; null where none is. */
  get shown(): { readonly picture: RefinedPicture; readonly camera: ViewCamera } | null {
    const [picture, camera] = [this.#picture, this.#layer?.shown];
    if (picture === null || camera === undefined || this.host.stage.overlay === null) return null;
    return refinedChannels.has(this.host.view().look.channel) ? { picture, camera } : null;
  }

  /** Something may have changed: where it did, the baked picture comes back. */
  changed(): void {
    const view = this.host.view();
    if (view.bundle !== this.#bundle || view.options.backend !== this.#backend) this.#close(view);
    const light = this.host.stage.light("a")?.prepared ?? null;
    if (!view.moving && keyOf(view) === this.#key && light === this.#light) return;
    this.#stop();
    if (this.#status.phase !== "failed") this.#set({ ...notRefining, phase: "waiting" });
  }

  /** The picture at rest was drawn: begin soon, unless this picture is refined already. */
  rest(afterMs = restMs): void {
    if (this.#key !== "" || this.#status.phase === "failed") return;
    clearTimeout(this.#rest);
    this.#rest = setTimeout(() => this.#begin(), afterMs) as unknown as number;
  }

  dispose(): void {
    this.#stop();
    this.#pool?.close();
    this.#pool = null;
  }

  #set(change: Partial<RefineStatus>): void {
    this.#status = { ...this.#status, ...change };
    this.host.tell(this.#status);
  }

  #close({ bundle, options }: RefineView): void {
    this.dispose();
    this.#opened = null;
    this.#sentLight = null;
    this.#bundle = bundle;
    this.#backend = options.backend;
    this.#set(notRefining);
  }

  #stop(): void {
    clearTimeout(this.#rest);
    cancelAnimationFrame(this.#frame);
    this.#key = "";
    this.#light = null;
    this.#pool?.ask({ ask: "stop" });
    this.#picture = null;
    this.host.stage.overlay = null;
    this.#layer?.dispose();
    this.#layer = null;
  }

  #begin(): void {
    const view = this.host.view();
    const light = this.host.stage.light("a");
    if (view.moving || light === null) return;
    this.#key = keyOf(view);
    this.#light = light.prepared;
    if (this.#opened === null) this.#open(view);
    else this.#start(view);
  }

  #open({ bundle, origin, options }: RefineView): void {
    this.#set({ phase: "loading" });
    if (this.#pool !== null) return;
    const { sceneId, mesh, transport } = bundle;
    const processors = navigator.hardwareConcurrency || 1;
    const count = workersFor(options, processors, bundle, globalThis.crossOriginIsolated);
    const asked = { origin, sceneId, mesh, transport, backend: options.backend };
    const pool: RefinePool = new RefinePool(asked, count, (answer) => {
      if (this.#pool === pool) this.#hear(answer);
    });
    this.#pool = pool;
  }

  #start(view: RefineView): void {
    const { stage } = this.host;
    const light = stage.light("a");
    if (light === null) return; // A new bundle is there, and its light is not yet.
    const { camera, options, turn, look, bundle } = view;
    const { slow, backend } = this.#opened!;
    const most = slow ? mostPoints.slow : backend === "mesh" ? mostPoints.mesh : mostPoints.quick;
    const limit = options.points > 0 ? options.points : most;
    const scale = Math.min(1, coarseSide / Math.max(camera.width, camera.height));
    const side = (length: number, share: number): number => Math.max(1, Math.round(length * share));
    const coarse = resized(camera, side(camera.width, scale), side(camera.height, scale));
    const ground = hasGround({ look, method: "baked" });
    const covered = readSamples(stage, coarse, 1, ground).place.length;
    const { step, samples } = planOf(
      camera.width,
      camera.height,
      covered / (coarse.width * coarse.height),
      limit,
    );
    const size = [side(camera.width, 1 / step), side(camera.height, 1 / step)] as const;
    const fine = step === 1 ? camera : resized(camera, ...size);
    const seen = readSamples(stage, fine, samples, ground);
    const edit = { ...look.edit, albedoScaleRgb: bundle.albedoScaleRgb };
    this.#layer = new RefinedLayer(camera, fine, edit, this.#fadeMs());
    const { levels } = light.prepared;
    const known = this.#sentLight === levels;
    this.#sentLight = levels;
    this.#pool?.ask({
      ask: "start",
      id: ++this.#id,
      levels: known ? null : levels,
      turn: turnMatrix(turn).flat(),
      intensity: turn.intensity,
      falling: light.falling(turn),
      edit,
      indirect: look.indirect,
      seen,
      options,
    });
    const note = [this.#opened!.note, bundle.adaptedNote].filter((text) => text !== "").join("; ");
    this.#set({ phase: "running", backend, note, samplesPerPixel: 0, relativeError: 0 });
  }

  #hear(answer: RefineAnswer): void {
    if (answer.kind === "failed") {
      this.#stop();
      this.#pool = null;
      this.#opened = null;
      this.#set({ phase: "failed", message: `${answer.message} [${answer.code}]` });
      this.host.redraw();
      return;
    }
    if (answer.kind === "opened") {
      this.#opened = answer;
      // Someone may have moved something while the networks came.
      if (this.#key !== "") this.#start(this.host.view());
      return;
    }
    if (answer.id !== this.#id || this.#layer === null) return;
    const { picture, shown, features, done } = answer;
    this.#picture = picture;
    this.#layer.set(shown ?? picture, features, { smoothed: shown !== null, done });
    this.host.stage.overlay = this.#layer;
    const { samplesPerPixel, relativeError } = picture;
    this.#set({ phase: done ? "done" : "running", samplesPerPixel, relativeError });
    this.#redraw();
  }

  #fadeMs(): number {
    return this.host.fades && !matchMedia("(prefers-reduced-motion: reduce)").matches ? fadeMs : 0;
  }

  /** Draw, again and again until the refined picture has come in. */
  #redraw(): void {
    cancelAnimationFrame(this.#frame);
    this.host.redraw();
    if (this.#layer?.isFading) this.#frame = requestAnimationFrame(() => this.#redraw());
  }
}

/** Return a text that is another one where the refined picture would be. */
function keyOf({ camera, turn, look }: RefineView): string {
  return JSON.stringify([camera, turn, look.edit, look.indirect, hasGround({ look, method: "baked" })]);
}
