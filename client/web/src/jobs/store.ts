/** The page's state of jobs: updated by the stream, read by the views. */

import type { Api, Job, JobEvent } from "../page/rest.js";
import { blobAddress } from "../page/addresses.js";
import type { StreamMessage } from "./stream.js";

/** Name of the sheet of an evaluation, whose pictures are too small for a card. */
const sheet = "evaluation";

/** A value of a curve; `atS` is Unix seconds. */
export type Sample = { readonly atS: number; readonly stage: string; readonly value: number };
export type Preview = { readonly sha256: string; readonly name: string };

/** Everything a job's page shows. Only jobs that a page has requested have a history. */
export type JobRecord = {
  job: Job;
  /** Number of the last event in the history; -1: it was not requested. */
  seq: number;
  psnr: Sample[];
  loss: Sample[];
  previews: Preview[];
  /** Time of the first event of each stage, Unix seconds. */
  stages: Map<string, number>;
};

/** The jobs and the listeners to their changes. */
export class JobStore {
  readonly #records = new Map<string, JobRecord>();
  readonly #listeners = new Set<(jobId: string) => void>();
  readonly #loading = new Map<string, Promise<void>>();

  constructor(private readonly api: Pick<Api, "job" | "events">) {}

  /** Call `listener` with the id of each job that changes; returns the function that ends it. */
  listen(listener: (jobId: string) => void): () => void {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  }

  get(jobId: string): JobRecord | undefined {
    return this.#records.get(jobId);
  }

  /** All jobs, the newest first: identifiers sort by the time they were made. */
  all(): JobRecord[] {
    return [...this.#records.values()].sort((a, b) => (a.job.id < b.job.id ? 1 : -1));
  }

  /** Take a job as the server shows it; older news than what is known changes nothing. */
  put(job: Job): void {
    const known = this.#records.get(job.id);
    if (known === undefined) {
      this.#records.set(job.id, {
        job,
        seq: -1,
        psnr: [],
        loss: [],
        previews: [],
        stages: new Map(),
      });
    } else if (job.last_event >= known.job.last_event) {
      known.job = job;
    }
    this.#tell(job.id);
  }

  /** Forget a job that was deleted. */
  forget(jobId: string): void {
    if (this.#records.delete(jobId)) this.#tell(jobId);
  }

  /** Ask the server for a job. */
  async refresh(jobId: string): Promise<void> {
    this.put(await this.api.job(jobId));
  }

  /** Fetch a job and its history, or what is missing of it; calling it again while it runs is one request. */
  loadHistory(jobId: string): Promise<void> {
    let loading = this.#loading.get(jobId);
    if (loading === undefined) {
      loading = this.#load(jobId).finally(() => this.#loading.delete(jobId));
      this.#loading.set(jobId, loading);
    }
    return loading;
  }

  async #load(jobId: string): Promise<void> {
    await this.refresh(jobId);
    const record = this.#records.get(jobId)!;
    record.seq = Math.max(record.seq, 0);
    for (;;) {
      const { items } = await this.api.events(jobId, record.seq);
      for (const event of items) addToHistory(record, event);
      if (items.length === 0 || record.seq >= record.job.last_event) break;
    }
    this.#tell(jobId);
  }

  /** Take a message of the stream. */
  receive(message: StreamMessage): void {
    if (message.event === "snapshot") {
      const job = JSON.parse(message.data) as Job;
      const before = this.#records.get(job.id);
      this.put(job);
      // The history may lack what happened while the stream was interrupted.
      if (before !== undefined && before.seq >= 0 && before.seq < job.last_event) this.#catchUp(job.id);
      return;
    }
    if (message.event !== "event") return;
    const event = JSON.parse(message.data) as JobEvent;
    const record = this.#records.get(event.job_id);
    if (record === undefined || event.type === "state") {
      // Details of a state (times, error, bundle) are only in the job.
      this.refresh(event.job_id).catch(() => {});
    } else if (event.seq > record.job.last_event) {
      const progress = event.progress ?? record.job.progress;
      const run = event.run || record.job.run;
      record.job = { ...record.job, progress, run, last_event: event.seq };
      if (event.type === "preview" && event.sha256 !== "" && event.name !== sheet) {
        record.job.thumbnail_url = blobAddress(event.sha256);
      }
    }
    if (record === undefined) return;
    if (record.seq >= 0) {
      if (event.seq === record.seq + 1) addToHistory(record, event);
      else if (event.seq > record.seq) this.#catchUp(event.job_id);
    }
    this.#tell(event.job_id);
  }

  #catchUp(jobId: string): void {
    // If the server does not answer, the next message tries again.
    this.loadHistory(jobId).catch(() => {});
  }

  #tell(jobId: string): void {
    for (const listener of this.#listeners) listener(jobId);
  }
}

/** Take the part of an event that curves, stages and pictures show; an event that is known changes nothing. */
export function addToHistory(record: JobRecord, event: JobEvent): void {
  if (event.seq <= record.seq) return;
  record.seq = event.seq;
  const atS = Date.parse(event.at) / 1000;
  if (event.type === "preview" && event.sha256 !== "") {
    record.previews.push({ sha256: event.sha256, name: event.name });
  }
  if (event.progress === null) return;
  const { stage, psnr, loss } = event.progress;
  if (!record.stages.has(stage)) record.stages.set(stage, atS);
  if (psnr > 0) record.psnr.push({ atS, stage, value: psnr });
  if (loss > 0) record.loss.push({ atS, stage, value: loss });
}
