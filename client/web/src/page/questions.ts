/** Numbered questions to a worker and their answers. */

import { texts } from "../words/words.js";

export type Unnumbered<T> = T extends { readonly id: number } ? Omit<T, "id"> : never;
type Waiting<Answer> = {
  readonly resolve: (answer: Answer) => void;
  readonly reject: (fault: Error) => void;
};

/** The page's side of a worker; one that cannot be started rejects all questions, now and later. */
export class Questions<Question extends { readonly id: number }, Answer extends { readonly id: number }> {
  readonly #waiting = new Map<number, Waiting<Answer>>();
  #fault: Error | null = null;
  #next = 1;

  constructor(private readonly worker: Worker) {
    worker.addEventListener("message", ({ data }: MessageEvent<Answer>) => {
      this.#waiting.get(data.id)?.resolve(data);
      this.#waiting.delete(data.id);
    });
    worker.addEventListener("error", (event) => {
      const fault = new Error(event.message || texts.page.partFailed);
      // Only a script that failed to load has no message; after any other error the worker continues.
      if (!event.message) this.#fault = fault;
      for (const { reject } of this.#waiting.values()) reject(fault);
      this.#waiting.clear();
    });
  }

  /** Ask, and return the answer to it. */
  ask(question: Unnumbered<Question>): Promise<Answer> {
    if (this.#fault !== null) return Promise.reject(this.#fault);
    const id = this.#next++;
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject });
      this.worker.postMessage({ ...question, id });
    });
  }

  /** End the worker; what is not answered yet is rejected with an AbortError, and so is what is asked later. */
  close(): void {
    this.worker.terminate();
    const fault = new DOMException("the page's part that answers was closed", "AbortError");
    this.#fault = fault;
    for (const { reject } of this.#waiting.values()) reject(fault);
    this.#waiting.clear();
  }
}
