/** The events of a viewer, and who listens to them. */

import type { LoadedBundle } from "../bundle/load.js";
import type { RefineStatus } from "../refine/status.js";

export type ViewerEvents = {
  readonly change: () => void;
  /** The bundle that is being read is there, and has a name. */
  readonly opened: (name: string) => void;
  /** A bundle is being read; bytes that have come, and all. */
  readonly progress: (readBytes: number, totalBytes: number) => void;
  readonly load: (bundle: LoadedBundle) => void;
  readonly draw: () => void;
  /** Refining came further, or to an end. */
  readonly refine: (status: RefineStatus) => void;
  /** Something to tell; `problem` where it went wrong. */
  readonly message: (text: string, problem: boolean) => void;
};

/** Tells listeners what happens. */
export class Emitter {
  readonly #listeners = new Map<keyof ViewerEvents, Set<(...values: never[]) => void>>();

  /** Call `listener` whenever `name` happens; returns what stops it. */
  on<N extends keyof ViewerEvents>(name: N, listener: ViewerEvents[N]): () => void {
    const all = this.#listeners.get(name) ?? new Set();
    this.#listeners.set(name, all);
    all.add(listener);
    return () => all.delete(listener);
  }

  tell<N extends keyof ViewerEvents>(name: N, ...values: Parameters<ViewerEvents[N]>): void {
    for (const listener of this.#listeners.get(name) ?? []) {
      (listener as (...values: Parameters<ViewerEvents[N]>) => void)(...values);
    }
  }

  clear(): void {
    this.#listeners.clear();
  }
}
