/** The workers of a refinement: one that adds passes up and answers, and others that compute more of them. */

import { buffersOf, sharedCopy } from "../page/buffers.js";
import { startWorker } from "../page/workers.js";
import type { OpenQuestion, RefineAnswer, RefineQuestion } from "./messages.js";
import workerUrl from "./refineWorker.ts?worker&url";
import type { RefineOptions } from "./status.js";
import { deviceFaults } from "../words/words.js";

const mostWorkers = 4;
/** Bytes that all workers may hold of a bundle. */
export const mostBytes = 2 ** 30;
/** Bytes that each of them reads or computes for a texel: shadow bits, materials, and light. */
const bytesPerTexel = 168;

type Held = Pick<OpenQuestion, "mesh" | "transport">;

/**
 * Return how many workers to use: not more than memory allows, for each holds what a bundle has unless that is `shared`.
 * A fast cache has one, for graphics hardware is not shared.
 */
export function workersFor(
  { backend, workers }: RefineOptions,
  processors: number,
  { mesh, transport }: Held,
  shared: boolean,
): number {
  if (backend !== "mesh") return 1;
  const wanted = workers > 0 ? workers : Math.min(Math.max(processors - 1, 1), mostWorkers);
  const given = buffersOf({ mesh, transport }).reduce((sum, { byteLength }) => sum + byteLength, 0);
  const own = bytesPerTexel * transport.numTexels;
  const most = shared ? (mostBytes - given) / own : mostBytes / (given + own);
  return Math.max(Math.min(wanted, Math.floor(most)), 1);
}

/** Workers that get the same questions and answer as one. */
export class RefinePool {
  readonly #workers: Worker[] = [];
  #opening = 0;
  #closed = false;

  /** `hear` gets each answer: "opened" once all workers are, "failed" at most once. */
  constructor(
    open: Omit<OpenQuestion, "share" | "ask">,
    count: number,
    private readonly hear: (answer: RefineAnswer) => void,
  ) {
    // Where the page is isolated from others, all workers read the same memory.
    const asked =
      count > 1 && globalThis.crossOriginIsolated
        ? { ...open, ...sharedCopy({ mesh: open.mesh, transport: open.transport }) }
        : open;
    const channels = Array.from({ length: count - 1 }, () => new MessageChannel());
    this.#opening = count;
    for (let index = 0; index < count; index++) {
      const worker = startWorker(workerUrl);
      this.#workers.push(worker);
      worker.onmessage = ({ data }: MessageEvent<RefineAnswer>) => this.#take(data);
      worker.onerror = (event) => {
        const message = event.message || deviceFaults.worker;
        this.#take({ kind: "failed", code: "refine.failed", message });
      };
      const ports = index === 0 ? channels.map(({ port1 }) => port1) : [channels[index - 1]!.port2];
      worker.postMessage(
        { ...asked, ask: "open", share: { index, count, ports } } satisfies OpenQuestion,
        ports,
      );
    }
  }

  ask(question: Exclude<RefineQuestion, OpenQuestion>): void {
    for (const worker of this.#workers) worker.postMessage(question);
  }

  close(): void {
    this.#closed = true;
    for (const worker of this.#workers) worker.terminate();
  }

  #take(answer: RefineAnswer): void {
    if (this.#closed) return;
    if (answer.kind === "opened" && --this.#opening > 0) return;
    if (answer.kind === "failed") this.close();
    this.hear(answer);
    // What the others compute further is of no use.
    if (answer.kind === "picture" && answer.done) this.ask({ ask: "stop", id: answer.id });
  }
}
