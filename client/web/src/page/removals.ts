/** Deletion that can be undone: what was deleted is only hidden for some seconds, then the server deletes it. */

import { explain } from "./actions.js";
import { h } from "./dom.js";
import { Refused } from "./rest.js";
import { fillIn, texts } from "../words/words.js";

export const undoMs = 10_000;

/** Something to delete; `send` tells the server, with `keepalive` so that it arrives after the page has gone. */
export type Removal = {
  readonly id: string;
  /** Its name as the subject of a sentence: 'The scene "Cup"'. */
  readonly what: string;
  readonly send: (keepalive: boolean) => Promise<unknown>;
  /** Called when it is gone for good. */
  readonly gone?: () => void;
};

type Waiting = { readonly removal: Removal; readonly timer: ReturnType<typeof setTimeout> };

/** Everything that is waiting to be deleted. */
export class Removals {
  readonly #waiting = new Map<string, Waiting>();
  /** Deleted, or about to be: lists that were requested earlier may still contain them. */
  readonly #sent = new Set<string>();
  readonly #listeners = new Set<() => void>();

  /** `fail` receives the server's refusal. */
  constructor(
    private readonly fail: (error: unknown) => void,
    private readonly delayMs = undoMs,
  ) {}

  /** Call `listener` when something is hidden, restored or deleted; returns the function that ends it. */
  listen(listener: () => void): () => void {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  }

  /** Whether lists leave this out. */
  hides(id: string): boolean {
    return this.#waiting.has(id) || this.#sent.has(id);
  }

  /** What can still be restored, the latest last. */
  get waiting(): readonly Removal[] {
    return [...this.#waiting.values()].map(({ removal }) => removal);
  }

  /** Hide something, and delete it after a while. */
  ask(removal: Removal): void {
    if (this.hides(removal.id)) return;
    const timer = setTimeout(() => void this.#send(removal.id, false), this.delayMs);
    this.#waiting.set(removal.id, { removal, timer });
    this.#tell();
  }

  /** Restore something that is waiting. */
  undo(id: string): void {
    clearTimeout(this.#waiting.get(id)?.timer);
    if (this.#waiting.delete(id)) this.#tell();
  }

  /** Delete at once what is waiting: the visitor leaves the page. */
  async flush(): Promise<void> {
    await Promise.all([...this.#waiting.keys()].map((id) => this.#send(id, true)));
  }

  async #send(id: string, keepalive: boolean): Promise<void> {
    const waiting = this.#waiting.get(id);
    if (waiting === undefined) return;
    clearTimeout(waiting.timer);
    this.#waiting.delete(id);
    this.#sent.add(id);
    this.#tell();
    try {
      await waiting.removal.send(keepalive);
      waiting.removal.gone?.();
    } catch (error) {
      // What another user has deleted meanwhile is gone as well.
      if (error instanceof Refused && error.status === 404) waiting.removal.gone?.();
      else {
        this.#sent.delete(id);
        this.fail(
          new Error(fillIn(texts.page.notDeleted, { what: waiting.removal.what, why: explain(error) })),
        );
      }
    }
    this.#tell();
  }

  #tell(): void {
    for (const listener of this.#listeners) listener();
  }
}

/** Return the notices, each with a button that undoes its deletion. */
export function removalNotices(removals: Removals): HTMLElement {
  const element = h("div", { class: "notices", role: "status" });
  const shown = new Map<string, HTMLElement>();
  removals.listen(() => {
    const ids = new Set(removals.waiting.map(({ id }) => id));
    for (const [id, notice] of shown) {
      if (ids.has(id)) continue;
      const had = notice.contains(document.activeElement);
      notice.remove();
      shown.delete(id);
      // The focus was on the notice; it continues at the top of the view.
      if (had) document.querySelector<HTMLElement>("#main h1")?.focus();
    }
    for (const { id, what } of removals.waiting) {
      if (shown.has(id)) continue;
      const undo = h(
        "button",
        { type: "button", "aria-label": fillIn(texts.page.undoDelete, { what }) },
        texts.page.undo,
      );
      undo.addEventListener("click", () => removals.undo(id));
      const notice = h("p", { class: "notice toast" }, fillIn(texts.page.deleted, { what }), " ", undo);
      shown.set(id, notice);
      element.append(notice);
      // The button that was pressed is gone, and undoing may be wanted next.
      undo.focus();
    }
  });
  return element;
}
