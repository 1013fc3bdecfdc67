/** The list of jobs with its search: pages from the server, and what happens meanwhile from the stream. */

import { button } from "../page/actions.js";
import { h, section, setText } from "../page/dom.js";
import { jobList, jobName } from "./jobLine.js";
import {
  everything,
  fragmentOf,
  kindChoices,
  matches,
  parametersOf,
  queryOf,
  stateChoices,
} from "./jobQuery.js";
import type { Context } from "./view.js";
import { fillIn, texts } from "../words/words.js";

const typingMs = 250;

const orders = new Map([
  ["newest", { text: () => texts.jobs.newest }],
  ["oldest", { text: () => texts.jobs.oldest }],
]);

/** The section of jobs. */
export class JobsPanel {
  #query = queryOf(location.hash);
  /** Jobs of the pages so far, in their order. */
  #found: string[] = [];
  #cursor: string | null = null;
  #asked = 0;
  #timer: ReturnType<typeof setTimeout> | undefined;
  readonly #words = h("input", {
    type: "search",
    id: "job-words",
    maxlength: 100,
    value: this.#query.words,
    placeholder: texts.jobs.searchHint,
    "aria-label": texts.jobs.search,
    oninput: () => {
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.#ask(), typingMs);
    },
  });
  readonly #state = this.#choice(texts.jobs.state, stateChoices, this.#query.state);
  readonly #kind = this.#choice(texts.jobs.kind, kindChoices, this.#query.kind);
  readonly #order = this.#choice(texts.jobs.order, orders, this.#query.oldestFirst ? "oldest" : "newest");
  readonly #list = jobList(texts.jobs.title, jobName);
  readonly #none = h("p", { class: "faint", hidden: true });
  readonly #news = h("p", { class: "sr", role: "status" });
  readonly #more: HTMLButtonElement;
  readonly element: HTMLElement;

  constructor(private readonly context: Context) {
    this.#more = button(texts.jobs.more, context, () => this.#fetch(this.#cursor));
    this.#more.hidden = true;
    this.element = section(
      texts.jobs.title,
      {},
      h("search", { class: "finder" }, this.#words, this.#state, this.#kind, this.#order),
      this.#news,
      this.#none,
      this.#list.element,
      h("div", { class: "actions" }, this.#more),
    );
  }

  load(): Promise<void> {
    return this.#fetch(null);
  }

  close(): void {
    clearTimeout(this.#timer);
  }

  update(): void {
    const { store, removals } = this.context;
    // What the stream has brought since: newer than all that was found, or older than nothing yet.
    const known = new Set(this.#found);
    const newest = this.#found.reduce((last, id) => (id > last ? id : last), "");
    const fresh = this.#query.oldestFirst
      ? []
      : store.all().flatMap(({ job }) => (!known.has(job.id) && job.id > newest ? [job.id] : []));
    const shown = [...fresh, ...this.#found].flatMap((id) => {
      const job = store.get(id)?.job;
      return job !== undefined && matches(this.#query, job) && !removals.hides(id) ? [job] : [];
    });
    this.#list.update(shown);
    this.#more.hidden = this.#cursor === null;
    this.#none.hidden = shown.length > 0;
    const narrowed = fragmentOf({ ...this.#query, oldestFirst: false }) !== fragmentOf(everything);
    setText(this.#none, narrowed ? texts.jobs.noMatch : texts.page.noneYet);
  }

  #ask(): void {
    this.#query = {
      words: this.#words.value,
      state: this.#state.value,
      kind: this.#kind.value,
      oldestFirst: this.#order.value === "oldest",
    };
    // Not a step of its own on the way back, and no other view.
    history.replaceState(null, "", fragmentOf(this.#query));
    this.load().catch(this.context.fail);
  }

  async #fetch(from: string | null): Promise<void> {
    this.#asked += 1;
    const mine = this.#asked;
    const page = await this.context.api.jobs(from, parametersOf(this.#query));
    // The visitor has typed on meanwhile.
    if (mine !== this.#asked) return;
    const ids = page.items.map((job) => job.id);
    this.#found = from === null ? ids : [...this.#found, ...ids];
    this.#cursor = page.next_cursor;
    for (const job of page.items) this.context.store.put(job);
    this.update();
    if (from !== null) return;
    const n = ids.length;
    setText(this.#news, fillIn(this.#cursor === null ? texts.jobs.found : texts.jobs.foundMore, { n }));
  }

  #choice(
    label: string,
    choices: ReadonlyMap<string, { readonly text: () => string }>,
    chosen: string,
  ): HTMLSelectElement {
    return h(
      "select",
      { "aria-label": label, onchange: () => this.#ask() },
      ...[...choices].map(([value, { text }]) => h("option", { value, selected: value === chosen }, text())),
    );
  }
}
