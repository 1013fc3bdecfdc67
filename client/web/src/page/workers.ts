/** Workers: started on pages of any origin, and asked numbered questions. */

import { locale, texts } from "../words/words.js";

const begun = new Map<string, string>();

/**
 * Start the module at `address` as a worker. Browsers refuse workers whose script has another origin than the page;
 * there a blob of the page imports it, which needs `blob:` and our origin under `worker-src` in a strict policy.
 */
export function startWorker(address: string): Worker {
  return new Worker(workerScript(new URL(address, location.href), location.origin), {
    type: "module",
    // Its messages are in the language of the page.
    name: locale,
  });
}

/** Return the address to start: that of the module, or of a script that imports it. */
export function workerScript(address: URL, origin: string): string {
  if (address.origin === origin) return address.href;
  const known = begun.get(address.href);
  if (known !== undefined) return known;
  const text = `import ${JSON.stringify(address.href)};`;
  const made = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  begun.set(address.href, made);
  return made;
}

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

  /** End the worker; open questions and later ones are rejected with an AbortError. */
  close(): void {
    this.worker.terminate();
    const fault = new DOMException("the page's part that answers was closed", "AbortError");
    this.#fault = fault;
    for (const { reject } of this.#waiting.values()) reject(fault);
    this.#waiting.clear();
  }
}
