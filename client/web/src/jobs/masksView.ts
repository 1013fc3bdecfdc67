/** The masks of a scene: what was found, and the editor in which a person corrects it. */

import { button } from "../page/actions.js";
import { jobAddress, sceneAddress } from "../page/addresses.js";
import { h, replaceKeyed, setText } from "../page/dom.js";
import { formatPercent } from "../page/format.js";
import { type Job, newKey } from "../page/rest.js";
import type { Finished, MaskBackend } from "../masks/backend.js";
import { latestPrepared, type Prepared, RestMaskBackend, readPrepared } from "../masks/restBackend.js";
import { progressText } from "./jobLine.js";
import { isFinal } from "./store.js";
import type { Context, View } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** Makes the element in which masks are corrected. */
export type OpenEditor = (given: {
  readonly backend: MaskBackend;
  readonly fail: (error: unknown) => void;
  readonly finishLabel: string;
  readonly finished: (finished: Finished) => void;
}) => Promise<{ readonly element: HTMLElement; readonly close: () => void }>;

/** Return in words how far the masks are to be believed. */
export function verdict({ preparation }: Prepared): string {
  const { editable, reason, doubtful, overlap } = preparation;
  if (!editable) return texts.masks.brought;
  if (reason !== "") return fillIn(texts.masks.unused, { reason });
  const share = formatPercent(overlap);
  if (doubtful.length === 0) return fillIn(texts.masks.agree, { share });
  return fillIn(texts.masks.agreeBut, { share, frames: doubtful.slice(0, 3).join(", ") });
}

/** Return the page; without `openEditor` masks are shown and cannot be corrected. */
export async function masksView(context: Context, sceneId: string, openEditor?: OpenEditor): Promise<View> {
  const { api, store, fail } = context;
  const scene = await api.scene(sceneId);
  const status = h("p", { class: "figures", role: "status" });
  const content = h("div");
  const again = button(texts.masks.again, context, order);
  let job: Job | null = null;
  let shown: string | null = null;
  let closed = false;
  let close: () => void = () => {};

  async function order(): Promise<void> {
    job = await api.submit({ scene_id: sceneId, kind: "prepare" }, newKey());
    store.put(job);
    draw();
  }

  async function show(done: Job): Promise<void> {
    if (shown === done.id) return;
    shown = done.id;
    const prepared = await readPrepared(api, done);
    if (closed) return;
    setText(status, verdict(prepared));
    if (openEditor === undefined || !prepared.preparation.editable) {
      content.replaceChildren(...sheetOf(prepared));
      return;
    }
    const backend = new RestMaskBackend(api, sceneId, prepared, newKey);
    const finished = ({ address }: Finished) => {
      if (address !== undefined) location.hash = address;
    };
    const editor = await openEditor({ backend, fail, finishLabel: texts.masks.use, finished });
    if (closed) {
      editor.close();
      return;
    }
    setText(status, "");
    close = () => editor.close();
    content.replaceChildren(editor.element);
  }

  function draw(): void {
    if (job === null) return;
    job = store.get(job.id)?.job ?? job;
    const { id, state, error } = job;
    again.hidden = state !== "failed" && state !== "cancelled";
    if (state === "succeeded") {
      show(job).catch(fail);
      return;
    }
    if (isFinal(job)) setText(status, error?.message ?? texts.masks.jobCancelled);
    else setText(status, progressText(job) || texts.masks.waiting);
    replaceKeyed(content, id, () => [h("p", {}, h("a", { href: jobAddress(id) }, texts.masks.theJob))]);
  }

  job = await latestPrepared(api, sceneId);
  if (job === null) {
    const running = store.all().find((each) => isUnderWay(each.job, sceneId));
    if (running === undefined) await order();
    else job = running.job;
  }
  draw();

  return {
    title: fillIn(texts.masks.pageOf, { scene: scene.name }),
    element: h(
      "div",
      {},
      h("p", {}, h("a", { href: sceneAddress(sceneId) }, texts.masks.theScene)),
      h("h1", { tabindex: -1 }, fillIn(texts.masks.titleOf, { scene: scene.name })),
      status,
      h("div", { class: "actions" }, again),
      content,
    ),
    update: (changed) => {
      if (job === null || shown !== null) return;
      if (changed === null) store.refresh(job.id).catch(fail);
      else if (changed === job.id) draw();
    },
    close: () => {
      closed = true;
      close();
    },
  };
}

function isUnderWay(job: Job, sceneId: string): boolean {
  return job.kind === "prepare" && job.scene_id === sceneId && !isFinal(job);
}

function sheetOf({ artifacts }: Prepared): HTMLElement[] {
  const sheet = artifacts.get("masks.jpg");
  if (sheet === undefined) return [];
  const alt = texts.masks.sheet;
  return [h("img", { src: sheet.url, alt, class: "sheet" })];
}
