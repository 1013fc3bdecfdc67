/** The masks of a scene: what was found, and the editor in which a person corrects it. */

import { button } from "../page/actions.js";
import { jobAddress, sceneAddress } from "../page/addresses.js";
import { h, replaceKeyed, setText } from "../page/dom.js";
import { formatPercent } from "../page/format.js";
import { isFinal, type Job, newKey, type Scene } from "../page/rest.js";
import { type Editor, maskEditor } from "../masks/editor.js";
import { latestPrepared, type Prepared, RestMaskBackend, readPrepared } from "../masks/restBackend.js";
import { progressText } from "./jobLine.js";
import type { Context, View } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** Return in words how reliable the masks are. */
export function verdict({ preparation }: Prepared): string {
  const { editable, reason, doubtful, overlap } = preparation;
  if (!editable) return texts.masks.brought;
  if (reason !== "") return fillIn(texts.masks.unused, { reason });
  const share = formatPercent(overlap);
  if (doubtful.length === 0) return fillIn(texts.masks.agree, { share });
  return fillIn(texts.masks.agreeBut, { share, frames: doubtful.slice(0, 3).join(", ") });
}

/** Return the page. */
export async function masksView(context: Context, sceneId: string): Promise<View> {
  const { api, store } = context;
  const scene = await api.scene(sceneId);
  const job =
    (await latestPrepared(api, sceneId)) ??
    store.all().find((each) => isUnderWay(each.job, sceneId))?.job ??
    (await order(context, sceneId));
  return new MasksView(context, scene, job);
}

async function order({ api, store }: Context, sceneId: string): Promise<Job> {
  const job = await api.submit({ scene_id: sceneId, kind: "prepare" }, newKey());
  store.put(job);
  return job;
}

class MasksView implements View {
  readonly title: string;
  readonly element: HTMLElement;
  readonly #status = h("p", { class: "figures", role: "status" });
  readonly #content = h("div");
  readonly #again: HTMLButtonElement;
  #shown: string | null = null;
  #closed = false;
  #editor: Editor | null = null;

  constructor(
    private readonly context: Context,
    private readonly scene: Scene,
    private job: Job,
  ) {
    this.title = fillIn(texts.masks.pageOf, { scene: scene.name });
    this.#again = button(texts.masks.again, context, async () => {
      this.job = await order(context, scene.id);
      this.#draw();
    });
    this.element = h(
      "div",
      {},
      h("p", {}, h("a", { href: sceneAddress(scene.id) }, texts.masks.theScene)),
      h("h1", { tabindex: -1 }, fillIn(texts.masks.titleOf, { scene: scene.name })),
      this.#status,
      h("div", { class: "actions" }, this.#again),
      this.#content,
    );
    this.#draw();
  }

  update(changed: string | null): void {
    if (this.#shown !== null) return;
    if (changed === null) this.context.store.refresh(this.job.id).catch(this.context.fail);
    else if (changed === this.job.id) this.#draw();
  }

  close(): void {
    this.#closed = true;
    this.#editor?.close();
  }

  #draw(): void {
    this.job = this.context.store.get(this.job.id)?.job ?? this.job;
    const { id, state, error } = this.job;
    this.#again.hidden = state !== "failed" && state !== "cancelled";
    if (state === "succeeded") {
      this.#show().catch(this.context.fail);
      return;
    }
    const told = isFinal(this.job)
      ? (error?.message ?? texts.masks.jobCancelled)
      : progressText(this.job) || texts.masks.waiting;
    setText(this.#status, told);
    replaceKeyed(this.#content, id, () => [h("p", {}, h("a", { href: jobAddress(id) }, texts.masks.theJob))]);
  }

  /** Show the masks of the job, which has succeeded. */
  async #show(): Promise<void> {
    if (this.#shown === this.job.id) return;
    this.#shown = this.job.id;
    const { api, fail } = this.context;
    const prepared = await readPrepared(api, this.job);
    if (this.#closed) return;
    setText(this.#status, verdict(prepared));
    if (!prepared.preparation.editable) {
      this.#content.replaceChildren(...sheetOf(prepared));
      return;
    }
    const backend = new RestMaskBackend(api, this.scene.id, prepared, newKey);
    const finished = (address: string) => {
      location.hash = address;
    };
    const editor = await maskEditor({ backend, fail, finishLabel: texts.masks.use, finished });
    if (this.#closed) {
      editor.close();
      return;
    }
    setText(this.#status, "");
    this.#editor = editor;
    this.#content.replaceChildren(editor.element);
  }
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
