/** The list of jobs with its search: pages from the server, and what happens meanwhile from the stream. */

import { button } from "../page/actions.js";
import { h, section, setText } from "../page/dom.js";
import type { Job } from "../page/rest.js";
import { jobList, jobName } from "./jobLine.js";
import {
  everything,
  fragmentOf,
  type JobQuery,
  kindChoices,
  matches,
  parametersOf,
  queryOf,
  stateChoices,
} from "./jobQuery.js";
import type { Context } from "./view.js";
import { fillIn, texts } from "../words/words.js";

const typingMs = 250;

/** Return the section of jobs. */
export function jobsPanel(context: Context) {
  const { api, store, removals, fail } = context;
  let query = queryOf(location.hash);
  /** Jobs of the pages so far, in their order. */
  let found: string[] = [];
  let cursor: string | null = null;
  let asked = 0;
  let timer: ReturnType<typeof setTimeout> | undefined;

  const words = h("input", {
    type: "search",
    id: "job-words",
    maxlength: 100,
    value: query.words,
    placeholder: texts.jobs.searchHint,
    "aria-label": texts.jobs.search,
  });
  const state = choice(texts.jobs.state, stateChoices, query.state);
  const kind = choice(texts.jobs.kind, kindChoices, query.kind);
  const order = choice(
    texts.jobs.order,
    new Map([
      ["newest", { text: () => texts.jobs.newest }],
      ["oldest", { text: () => texts.jobs.oldest }],
    ]),
    query.oldestFirst ? "oldest" : "newest",
  );
  const list = jobList(texts.jobs.title, jobName);
  const none = h("p", { class: "faint", hidden: true });
  const news = h("p", { class: "sr", role: "status" });
  const more = button(texts.jobs.more, context, () => fetchPage(query, cursor));
  more.hidden = true;

  function ask(): void {
    query = {
      words: words.value,
      state: state.value,
      kind: kind.value,
      oldestFirst: order.value === "oldest",
    };
    // Not a step of its own on the way back, and no other view.
    history.replaceState(null, "", fragmentOf(query));
    fetchPage(query, null).catch(fail);
  }

  async function fetchPage(wanted: JobQuery, from: string | null): Promise<void> {
    asked += 1;
    const mine = asked;
    const page = await api.jobs(from, parametersOf(wanted));
    // The visitor has typed on meanwhile.
    if (mine !== asked) return;
    const ids = page.items.map((job) => job.id);
    found = from === null ? ids : [...found, ...ids];
    cursor = page.next_cursor;
    for (const job of page.items) store.put(job);
    draw();
    if (from === null) {
      setText(news, fillIn(cursor === null ? texts.jobs.found : texts.jobs.foundMore, { n: found.length }));
    }
  }

  function draw(): void {
    // What the stream has brought since: newer than all that was found, or older than nothing yet.
    const known = new Set(found);
    const newest = found.reduce((last, id) => (id > last ? id : last), "");
    const fresh = query.oldestFirst
      ? []
      : store.all().flatMap(({ job }) => (!known.has(job.id) && job.id > newest ? [job.id] : []));
    const shown = [...fresh, ...found].flatMap((id) => {
      const job: Job | undefined = store.get(id)?.job;
      return job !== undefined && matches(query, job) && !removals.hides(id) ? [job] : [];
    });
    list.update(shown);
    more.hidden = cursor === null;
    none.hidden = shown.length > 0;
    const narrowed = fragmentOf({ ...query, oldestFirst: false }) !== fragmentOf(everything);
    setText(none, narrowed ? texts.jobs.noMatch : texts.page.noneYet);
  }

  words.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(ask, typingMs);
  });
  for (const each of [state, kind, order]) each.addEventListener("change", ask);

  return {
    element: section(
      texts.jobs.title,
      {},
      h("search", { class: "finder" }, words, state, kind, order),
      news,
      none,
      list.element,
      h("div", { class: "actions" }, more),
    ),
    load: () => fetchPage(query, null),
    update: draw,
    close: () => clearTimeout(timer),
  };
}

function choice(
  label: string,
  choices: ReadonlyMap<string, { readonly text: () => string }>,
  chosen: string,
): HTMLSelectElement {
  return h(
    "select",
    { "aria-label": label },
    ...[...choices].map(([value, { text }]) => h("option", { value, selected: value === chosen }, text())),
  );
}
