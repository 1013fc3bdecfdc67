/** Sends corrections shortly after the last change; a later change aborts what is under way. */

import type { Applied } from "./backend.js";
import type { Correction } from "./corrections.js";

export type ApplyState =
  | { readonly kind: "applying" }
  | { readonly kind: "applied"; readonly applied: Applied; readonly seconds: number }
  | { readonly kind: "failed"; readonly error: unknown };

type Apply = (corrections: readonly Correction[], signal: AbortSignal) => Promise<Applied>;

const delayMs = 350;

export class Applier {
  #timer: ReturnType<typeof setTimeout> | undefined;
  #running = new AbortController();

  constructor(
    private readonly apply: Apply,
    private readonly tell: (state: ApplyState) => void,
  ) {}

  /** Take these as all corrections. */
  change(corrections: readonly Correction[]): void {
    this.stop();
    this.#timer = setTimeout(() => void this.#run(corrections), delayMs);
  }

  /** Abort what is under way. */
  stop(): void {
    clearTimeout(this.#timer);
    this.#running.abort();
  }

  async #run(corrections: readonly Correction[]): Promise<void> {
    const mine = new AbortController();
    this.#running = mine;
    const started = performance.now();
    this.tell({ kind: "applying" });
    try {
      const applied = await this.apply(corrections, mine.signal);
      if (mine.signal.aborted) return;
      this.tell({ kind: "applied", applied, seconds: (performance.now() - started) / 1000 });
    } catch (error) {
      if (!mine.signal.aborted) this.tell({ kind: "failed", error });
    }
  }
}
