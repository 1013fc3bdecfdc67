/** The workers of a refinement: one that adds passes up and answers, and others that compute more of them. */

import { startWorker } from "../page/workers.js";
import type { OpenQuestion, RefineAnswer, RefineQuestion } from "./messages.js";
import workerUrl from "./refineWorker.ts?worker&url";
import type { RefineOptions } from "./status.js";
import { deviceFaults } from "../words/deviceFaults.js";

const mostWorkers = 4;

/** Return how many workers to use; a fast cache has one, for graphics hardware is not shared. */
export function workersFor({ backend, workers }: RefineOptions, processors: number): number {
  if (backend !== "auto" && backend !== "mesh") return 1;
  return workers > 0 ? workers : Math.min(Math.max(processors - 1, 1), mostWorkers);
}

/** Some workers that are asked together and answer as one. */
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
        { ...open, ask: "open", share: { index, count, ports } } satisfies OpenQuestion,
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
