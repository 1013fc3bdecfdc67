/** The start: drop a capture; jobs, scenes and bundles. */

import { button } from "../page/actions.js";
import { jobAddress, sceneAddress, viewerAddress } from "../page/addresses.js";
import { h, section } from "../page/dom.js";
import { formatSize, formatTime, plural } from "../page/format.js";
import type { Bundle, Scene } from "../page/rest.js";
import { thumbnailOf } from "../page/thumbnail.js";
import { jobsPanel } from "./jobsPanel.js";
import { isFinal } from "./store.js";
import { uploadPanel } from "./uploadPanel.js";
import { type Context, stateLabel, type View } from "./view.js";

type Page<T> = { readonly items: readonly T[]; readonly next_cursor: string | null };

/** Return the start of the page. */
export function startView(context: Context): View {
  const { api, store, fail } = context;
  const panel = uploadPanel(context, null);
  const jobs = jobsPanel(context);
  const scenes = pagedList("Scenes, the newest first", sceneLine, api.scenes, context);
  const bundles = pagedList("Bundles, the newest first", bundleLine, api.bundles, context);

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
  const stopUploads = context.uploads.listen(() => void scenes.load().catch(() => {}));
  return {
    title: "Lambent",
    element: h(
      "div",
      {},
      h("h1", { tabindex: -1 }, "Relight your photographs"),
      h("section", { "aria-label": "New scene" }, panel.element),
      jobs.element,
      section("Bundles", {}, bundles.element),
      section("Scenes", {}, scenes.element),
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
  const size =
    scene.num_files > 0 ? `${plural(scene.num_files, "file")}, ${formatSize(scene.size_bytes)} · ` : "";
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
    h("p", { class: "faint" }, `${size}${formatTime(scene.created_at)}`),
  );
}

function bundleLine(bundle: Bundle): HTMLLIElement {
  const name = bundle.scene_name || bundle.scene_id;
  return h(
    "li",
    { class: "card tile" },
    thumbnailOf(bundle.thumbnail_url),
    h("div", { class: "line" }, h("h3", {}, h("a", { href: jobAddress(bundle.job_id) }, name))),
    h("p", { class: "faint" }, `${formatSize(bundle.size_bytes)} · ${formatTime(bundle.created_at)}`),
    h("div", {}, h("a", { class: "button", href: viewerAddress(bundle.id) }, `View ${name}`)),
  );
}

/** Return the button that fetches the page after the last one; `after` tells which that was. */
function nextPages<T>(
  text: string,
  ask: (cursor: string | null) => Promise<Page<T>>,
  take: (items: readonly T[]) => void,
  context: Context,
) {
  let cursor: string | null = null;
  const more = button(text, context, async () => {
    const page = await ask(cursor);
    after(page);
    take(page.items);
  });
  more.hidden = true;
  function after(page: Page<T>): void {
    cursor = page.next_cursor;
    more.hidden = cursor === null;
  }
  return { button: more, after };
}

/** Return a list that is loaded page by page. */
function pagedList<T>(
  label: string,
  line: (item: T) => HTMLLIElement,
  ask: (cursor: string | null) => Promise<Page<T>>,
  context: Context,
) {
  const list = h("ol", { class: "list tiles", "aria-label": label });
  const empty = h("p", { class: "faint", hidden: true }, "None yet.");
  const more = nextPages("Show older ones", ask, (items) => list.append(...items.map(line)), context);
  let shown = "";
  return {
    element: h("div", {}, empty, list, h("div", { class: "actions" }, more.button)),
    /** Fetch the first page again. */
    load: async (): Promise<readonly T[]> => {
      const page = await ask(null);
      const text = JSON.stringify(page);
      if (text !== shown) {
        shown = text;
        list.replaceChildren(...page.items.map(line));
        more.after(page);
        empty.hidden = page.items.length > 0;
        list.hidden = page.items.length === 0;
      }
      return page.items;
    },
  };
}
