/** The editor of masks on a server: jobs of the kind `prepare` compute the masks, their artifacts are shown. */

import { sceneAddress } from "../page/addresses.js";
import { type Api, type Artifact, isFinal, type Job } from "../page/rest.js";
import type { Applied, Capture, MaskBackend } from "./backend.js";
import type { CorrectionList } from "./corrections.js";
import { fillIn, named, texts } from "../words/words.js";

/** `preparation/frames.json` of a job: see `lambent_capture.masks.preview`. */
export type Preparation = {
  readonly version: number;
  /** Whether corrections are possible, which they are not for masks that came with the capture. */
  readonly editable: boolean;
  /** How well the views agree, 0..1. */
  readonly overlap: number;
  readonly doubtful: readonly string[];
  readonly reason: string;
  readonly frames: readonly {
    readonly name: string;
    /** Pixels of the photograph. */
    readonly width: number;
    readonly height: number;
    readonly picture: string;
    readonly mask: string;
    readonly overlap?: number;
  }[];
};

/** A `prepare` job that has succeeded, with its results. */
export type Prepared = {
  readonly job: Job;
  readonly preparation: Preparation;
  /** By name. */
  readonly artifacts: ReadonlyMap<string, Artifact>;
};

/** The part of the REST API that the backend uses. */
export type PreparationApi = Pick<
  Api,
  "submit" | "waitForJob" | "artifacts" | "document" | "blob" | "cancel" | "deleteJob" | "jobsOf"
>;

const folder = "preparation/";
const version = 1;

/** Settings of how a capture is read, which corrections depend on. */
const settingsOfReading = ["layout", "lights", "masks", "known_lights"];

/** Return the text of corrections as a parameter of a job; empty where there are none. */
export function correctionsText(corrections: CorrectionList): string {
  return corrections.corrections.length === 0 ? "" : JSON.stringify(corrections);
}

/** Return the corrections of a job. */
export function correctionsOf(job: Job): CorrectionList {
  const text = job.params.corrections ?? "";
  return text === "" ? { version: 1, corrections: [] } : (JSON.parse(text) as CorrectionList);
}

/** Return the results of a job; throws if it did not prepare a scene, or for another version. */
export async function readPrepared(api: PreparationApi, job: Job): Promise<Prepared> {
  const { items } = await api.artifacts(job.id);
  const artifacts = new Map(items.map((item) => [item.name, item]));
  const frames = artifacts.get(`${folder}frames.json`);
  if (frames === undefined) throw new Error(fillIn(texts.masks.noMasks, { job: job.id }));
  const preparation = await api.document<Preparation>(frames.url);
  if (preparation.version !== version) {
    throw new Error(fillIn(texts.masks.version, { found: preparation.version, known: version }));
  }
  return { job, preparation, artifacts };
}

/** Return the newest job that has prepared a scene, or null. */
export async function latestPrepared(api: PreparationApi, sceneId: string): Promise<Job | null> {
  const { items } = await api.jobsOf(sceneId, "prepare", "succeeded", 1);
  return items[0] ?? null;
}

/** Corrects the masks of one scene. Each change is a job; only the last one is kept. */
export class RestMaskBackend implements MaskBackend {
  #shown: Prepared;
  /** Jobs of this page, which alone it deletes. */
  readonly #mine = new Set<string>();

  constructor(
    private readonly api: PreparationApi,
    private readonly sceneId: string,
    prepared: Prepared,
    private readonly newKey: () => string,
  ) {
    this.#shown = prepared;
  }

  async load(): Promise<Capture> {
    const { job, preparation } = this.#shown;
    const doubtful = new Set(preparation.doubtful);
    return {
      frames: preparation.frames.map(({ name, width, height }) => ({
        name,
        width,
        height,
        doubtful: doubtful.has(name),
      })),
      corrections: correctionsOf(job),
      agreement: preparation.overlap,
      reason: preparation.reason,
    };
  }

  /** `side` has no effect: the server keeps one size. */
  picture(frame: string, _side: number): Promise<Blob> {
    return this.api.blob(this.#file(frame, "picture").url);
  }

  mask(frame: string): Promise<Blob> {
    return this.api.blob(this.#file(frame, "mask").url);
  }

  async apply(corrections: CorrectionList, signal: AbortSignal): Promise<Applied> {
    const before = this.#shown;
    const job = await this.#order(corrections, signal);
    const after = await readPrepared(this.api, job);
    signal.throwIfAborted();
    const changed = after.preparation.frames.filter(
      ({ mask }) =>
        before.artifacts.get(folder + mask)?.sha256 !== after.artifacts.get(folder + mask)?.sha256,
    );
    this.#shown = after;
    if (this.#mine.delete(before.job.id)) {
      // It is not used again; if it cannot be deleted yet, the visitor need not know.
      await this.api.deleteJob(before.job.id).catch(() => {});
    }
    this.#mine.add(job.id);
    return {
      agreement: after.preparation.overlap,
      doubtful: after.preparation.doubtful,
      changed: changed.map(({ name }) => name),
    };
  }

  async finish(corrections: CorrectionList): Promise<string> {
    if (correctionsText(corrections) !== correctionsText(correctionsOf(this.#shown.job))) {
      await this.apply(corrections, new AbortController().signal);
    }
    this.#mine.clear();
    return sceneAddress(this.sceneId);
  }

  async #order(corrections: CorrectionList, signal: AbortSignal): Promise<Job> {
    const { job: base } = this.#shown;
    const kept = Object.entries(base.params).filter(([name]) => settingsOfReading.includes(name));
    const text = correctionsText(corrections);
    const params = { ...Object.fromEntries(kept), ...(text === "" ? {} : { corrections: text }) };
    let job = await this.api.submit(
      { scene_id: this.sceneId, kind: "prepare", preset: base.preset, seed: base.seed, params },
      this.newKey(),
    );
    try {
      while (!isFinal(job)) {
        signal.throwIfAborted();
        job = await this.api.waitForJob(job.id, signal);
      }
    } catch (error) {
      if (signal.aborted) await this.api.cancel(job.id).catch(() => {});
      throw error;
    }
    if (job.state !== "succeeded") {
      throw new Error(
        job.error?.message ?? fillIn(texts.masks.notComputed, { state: named(texts.states, job.state) }),
      );
    }
    return job;
  }

  #file(frame: string, kind: "picture" | "mask"): Artifact {
    const entry = this.#shown.preparation.frames.find(({ name }) => name === frame);
    const file = entry === undefined ? undefined : this.#shown.artifacts.get(folder + entry[kind]);
    if (file === undefined) {
      throw new Error(
        kind === "mask" ? fillIn(texts.masks.noMask, { frame }) : fillIn(texts.masks.noPicture, { frame }),
      );
    }
    return file;
  }
}
