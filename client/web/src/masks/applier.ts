/** Sends corrections shortly after the last change; what is overtaken by a later change is ended. */

import type { Applied } from "./backend.js";
import type { Correction } from "./corrections.js";

export type ApplyState =
  | { readonly kind: "applying" }
  | { readonly kind: "applied"; readonly applied: Applied; readonly seconds: number }
  | { readonly kind: "failed"; readonly error: unknown };

type Apply = (corrections: readonly Correction[], signal: AbortSignal) => Promise<Applied>;

export class Applier {
  #timer: ReturnType<typeof setTimeout> | undefined;
  #running = new AbortController();

  constructor(
    private readonly apply: Apply,
    private readonly tell: (state: ApplyState) => void,
    private readonly delayMs = 350,
    private readonly now: () => number = () => performance.now(),
  ) {}

  /** All corrections are these now. */
  change(corrections: readonly Correction[]): void {
    this.stop();
    this.#timer = setTimeout(() => void this.#run(corrections), this.delayMs);
  }

  /** Forget what is being applied. */
  stop(): void {
    clearTimeout(this.#timer);
    this.#running.abort();
  }

  async #run(corrections: readonly Correction[]): Promise<void> {
    const mine = new AbortController();
    this.#running = mine;
    const started = this.now();
    this.tell({ kind: "applying" });
    try {
      const applied = await this.apply(corrections, mine.signal);
      if (mine.signal.aborted) return;
      this.tell({ kind: "applied", applied, seconds: (this.now() - started) / 1000 });
    } catch (error) {
      if (!mine.signal.aborted) this.tell({ kind: "failed", error });
    }
  }
}
