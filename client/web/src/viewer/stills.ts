/** Refined pictures that a viewer makes besides what it shows. */

import { interrupted } from "../render/fault.js";

/** What ends the work on one picture: `lost` says that it can no longer be made, and `end` is called in any case. */
export type Still = { readonly lost: AbortSignal; readonly end: () => void };

export class Stills {
  readonly #begun = new Set<AbortController>();

  get isAny(): boolean {
    return this.#begun.size > 0;
  }

  /** Begin a picture; `after` is called at its end. */
  begin(after: () => void): Still {
    const lost = new AbortController();
    this.#begun.add(lost);
    const end = (): void => {
      this.#begun.delete(lost);
      after();
    };
    return { lost: lost.signal, end };
  }

  /** Another bundle or light is shown now, or nothing. */
  lose(): void {
    for (const each of this.#begun) each.abort(interrupted("refine"));
  }
}
