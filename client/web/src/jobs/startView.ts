/** The start: drop a capture; jobs, scenes and bundles. */

import { button } from "../page/actions.js";
import { jobAddress, sceneAddress, viewerAddress } from "../page/addresses.js";
import { arrange, h, section } from "../page/dom.js";
import { formatSize, formatTime } from "../page/format.js";
import { type Bundle, isFinal, type Scene } from "../page/rest.js";
import { thumbnailOf } from "../page/thumbnail.js";
import { JobsPanel } from "./jobsPanel.js";
import { uploadPanel } from "./uploadPanel.js";
import { type Context, sizeText, stateLabel, type View } from "./view.js";
import { fillIn, texts } from "../words/words.js";

type Page<T> = { readonly items: readonly T[]; readonly next_cursor: string | null };

/** Return the start of the page. */
export function startView(context: Context): View {
  const { api, store, fail } = context;
  const panel = uploadPanel(context, null);
  const jobs = new JobsPanel(context);
  const scenes = pagedList(texts.start.sceneList, sceneLine, api.scenes, context);
  const bundles = pagedList(
    texts.start.bundleList,
    (bundle) => bundleLine(context, bundle),
    api.bundles,
    context,
  );

  async function load(): Promise<void> {
    await Promise.all([jobs.load(), scenes.load(), bundles.load()]);
  }
  load().catch(fail);

  const seen = new Map<string, string>();
  // The stream begins with a hundred jobs at once, which is one reason to look again and not a hundred.
  const lists = soon(() => {
    scenes.load().catch(() => {});
    bundles.load().catch(() => {});
  });
  const stopRemovals = context.removals.listen(() => {
    jobs.update();
    scenes.draw();
    bundles.draw();
  });
  const stopUploads = context.uploads.listen(() => void scenes.load().catch(() => {}));
  return {
    title: "Lambent",
    element: h(
      "div",
      {},
      h("h1", { tabindex: -1 }, texts.start.title),
      h("section", { "aria-label": texts.start.newScene }, panel.element),
      jobs.element,
      section(texts.start.bundles, {}, bundles.element),
      section(texts.start.scenes, {}, scenes.element),
    ),
    update: (jobId) => {
      if (jobId === null) {
        load().catch(fail);
        return;
      }
      const record = store.get(jobId);
      if (record === undefined) return;
      // A new job may be the first of a scene that another program has sent. One that has ended has given the
      // scene a photograph, or has made a bundle.
      const news = isFinal(record.job) ? "ended" : "made";
      if (seen.get(jobId) !== news) {
        seen.set(jobId, news);
        lists.ask();
      }
      jobs.update();
    },
    close: () => {
      panel.close();
      jobs.close();
      stopUploads();
      stopRemovals();
      lists.stop();
    },
  };
}

const soonMs = 400;

/** Return what calls `act` once, a moment after it was first asked. */
function soon(act: () => void): { ask: () => void; stop: () => void } {
  let timer: ReturnType<typeof setTimeout> | undefined;
  return {
    ask: () => {
      timer ??= setTimeout(() => {
        timer = undefined;
        act();
      }, soonMs);
    },
    stop: () => clearTimeout(timer),
  };
}

function sceneLine(scene: Scene): HTMLLIElement {
  return h(
    "li",
    { class: "card tile" },
    thumbnailOf(scene.thumbnail_url),
    h(
      "div",
      { class: "line" },
      h("h3", {}, h("a", { href: sceneAddress(scene.id) }, scene.name)),
      stateLabel(scene.state),
    ),
    h("p", { class: "faint" }, `${sizeText(scene)}${formatTime(scene.created_at)}`),
  );
}

function bundleLine(context: Context, bundle: Bundle): HTMLLIElement {
  const name = bundle.scene_name || bundle.scene_id;
  const remove = button(texts.page.delete, context, async () =>
    context.removals.ask({
      id: bundle.id,
      what: fillIn(texts.start.theBundle, { name }),
      send: (keepalive) => context.api.deleteBundle(bundle.id, keepalive),
    }),
  );
  remove.setAttribute("aria-label", fillIn(texts.start.deleteBundle, { name }));
  return h(
    "li",
    { class: "card tile" },
    thumbnailOf(bundle.thumbnail_url),
    h("div", { class: "line" }, h("h3", {}, h("a", { href: jobAddress(bundle.job_id) }, name))),
    h("p", { class: "faint" }, `${formatSize(bundle.size_bytes)} · ${formatTime(bundle.created_at)}`),
    h(
      "div",
      { class: "actions" },
      h(
        "a",
        { class: "button", href: viewerAddress(bundle.id) },
        texts.start.view,
        h("span", { class: "sr" }, ` ${name}`),
      ),
      remove,
    ),
  );
}

/** Return a list that is loaded page by page; what is being deleted is left out. */
function pagedList<T extends { readonly id: string }>(
  label: string,
  line: (item: T) => HTMLLIElement,
  ask: (cursor: string | null) => Promise<Page<T>>,
  context: Context,
) {
  const list = h("ol", { class: "list tiles", "aria-label": label });
  const empty = h("p", { class: "faint", hidden: true }, texts.page.noneYet);
  const more = button(texts.start.showOlder, context, async () => {
    const page = await ask(cursor);
    items = [...(items ?? []), ...page.items];
    cursor = page.next_cursor;
    draw();
  });
  more.hidden = true;
  let items: readonly T[] | null = null;
  let cursor: string | null = null;
  let first = "";
  const lines = new Map<string, { readonly text: string; readonly element: HTMLLIElement }>();

  function draw(): void {
    if (items === null) return;
    const shown = items.filter((item) => !context.removals.hides(item.id));
    const elements = shown.map((item) => {
      const text = JSON.stringify(item);
      let known = lines.get(item.id);
      if (known?.text !== text) {
        known = { text, element: line(item) };
        lines.set(item.id, known);
      }
      return known.element;
    });
    arrange(list, elements);
    more.hidden = cursor === null;
    empty.hidden = shown.length > 0;
    list.hidden = shown.length === 0;
  }

  return {
    element: h("div", {}, empty, list, h("div", { class: "actions" }, more)),
    draw,
    /** Fetch the first page again. */
    load: async (): Promise<void> => {
      const page = await ask(null);
      const text = JSON.stringify(page);
      if (text === first) return;
      first = text;
      items = page.items;
      cursor = page.next_cursor;
      draw();
    },
  };
}
