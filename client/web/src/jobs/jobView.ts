/** One job: live while it runs, its results when it is done. */

import { button } from "../page/actions.js";
import { jobAddress, masksAddress, sceneAddress } from "../page/addresses.js";
import { h, replaceKeyed, section, setText } from "../page/dom.js";
import { formatDuration, formatTime } from "../page/format.js";
import { isFinal, type Job, type Scene } from "../page/rest.js";
import { fractionDone, jobName, progressText, purpose } from "./jobLine.js";
import { curves, stageList } from "./live.js";
import { logView } from "./log.js";
import { Previews } from "./previews.js";
import { resultSection } from "./results.js";
import { type Context, stateLabel, type View } from "./view.js";
import { fillIn, named, texts } from "../words/words.js";

/** Return the page of a job. */
export async function jobView(context: Context, jobId: string): Promise<View> {
  const { api, store } = context;
  await store.loadHistory(jobId);
  const { job } = store.get(jobId)!;
  // A deleted scene has no name any more, and some jobs have no scene; the jobs stay.
  const scene = job.scene_id === "" ? null : await api.scene(job.scene_id).catch(() => null);
  return new JobView(context, job, scene);
}

class JobView implements View {
  readonly title: string;
  readonly element: HTMLElement;
  readonly #state = h("span");
  readonly #news = h("p", { class: "sr", role: "status" });
  readonly #bar = h("progress", { max: 1, "aria-label": texts.jobs.share });
  readonly #figures = h("p", { class: "figures" });
  readonly #fault = h("div");
  readonly #stages = stageList();
  readonly #pictures = new Previews();
  readonly #curves = curves();
  readonly #results = h("div");
  readonly #log;
  readonly #cancel;
  readonly #retry;
  readonly #remove;

  constructor(
    private readonly context: Context,
    private readonly first: Job,
    scene: Scene | null,
  ) {
    const { api, store } = context;
    const { id } = first;
    this.title = `${jobName(first)}: ${purpose(first)}`;
    this.#log = logView(context, id);
    this.#cancel = button(texts.page.cancel, context, async () => store.put(await api.cancel(id)));
    this.#retry = button(texts.job.runAgain, context, async () => {
      const fresh = await api.retry(id);
      store.put(fresh);
      location.hash = jobAddress(fresh.id);
    });
    this.#remove = button(texts.job.delete, context, async () => this.#delete());
    const masks = hasMasks(first) && scene !== null && masksLink(scene.id);
    this.element = h(
      "div",
      {},
      h("p", {}, h("a", { href: "#/" }, texts.start.allJobs)),
      h("h1", { tabindex: -1 }, jobName(first), " ", this.#state),
      this.#news,
      h(
        "p",
        { class: "faint" },
        `${purpose(first)} · ${formatTime(first.created_at)}`,
        scene !== null && " · ",
        scene !== null && h("a", { href: sceneAddress(scene.id) }, texts.job.scene),
      ),
      this.#bar,
      this.#figures,
      this.#fault,
      h("div", { class: "actions" }, this.#cancel, this.#retry, masks),
      this.#results,
      this.#progress(),
      this.#log.element,
      h("section", { "aria-label": texts.job.section }, h("div", { class: "actions" }, this.#remove)),
    );
    this.#draw();
  }

  update(changed: string | null): void {
    if (changed === null) this.context.store.loadHistory(this.first.id).catch(this.context.fail);
    else if (changed === this.first.id) this.#draw();
  }

  close(): void {
    this.#log.close();
    this.#pictures.close();
  }

  #progress(): HTMLElement {
    const live = h("div", { class: "live" }, this.#pictures.element, this.#curves.element);
    if (!isFinal(this.first)) return section(texts.job.progress, {}, live, this.#stages.element);
    return h("details", { class: "fold" }, h("summary", {}, texts.job.history), live, this.#stages.element);
  }

  #delete(): void {
    const { api, store, removals } = this.context;
    const { id } = this.first;
    removals.ask({
      id,
      what: fillIn(texts.job.theJob, { name: jobName(this.first) }),
      send: (keepalive) => api.deleteJob(id, keepalive),
      gone: () => store.forget(id),
    });
    location.hash = "#/";
  }

  #draw(): void {
    const record = this.context.store.get(this.first.id);
    if (record === undefined) return;
    const { job } = record;
    replaceKeyed(this.#state, job.state, () => [stateLabel(job.state)]);
    setText(this.#news, fillIn(texts.job.news, { state: named(texts.states, job.state) }));
    this.#bar.value = fractionDone(job);
    this.#bar.hidden = isFinal(job);
    setText(this.#figures, statusText(job));
    replaceKeyed(this.#fault, JSON.stringify([job.error, job.state]), () => faultNotice(job));
    this.#stages.element.hidden = job.kind !== "train" || job.started_at === null;
    for (const part of [this.#stages, this.#pictures, this.#curves]) part.update(record);
    this.#cancel.hidden = isFinal(job) || job.state === "cancelling";
    this.#remove.hidden = !isFinal(job);
    this.#retry.hidden = job.state !== "failed" && job.state !== "cancelled";
    replaceKeyed(this.#results, `${job.state} ${job.bundle_id}`, () => [
      resultSection(this.context, job, jobName(this.first)),
    ]);
    this.#log.update(job);
  }
}

/** Return the line below the bar. */
function statusText(job: Job): string {
  const parts = [];
  if (job.state === "queued") parts.push(texts.job.waiting);
  if (job.state === "cancelling") parts.push(texts.job.stopping);
  const progress = progressText(job);
  if (progress !== "") parts.push(progress);
  if (job.run > 1) parts.push(fillIn(texts.job.run, { number: job.run }));
  if (job.state === "retry_wait" && job.retry_at !== null) {
    const seconds = (Date.parse(job.retry_at) - Date.now()) / 1000;
    parts.push(fillIn(texts.job.nextTry, { time: formatDuration(seconds) }));
  }
  return parts.join(" · ");
}

function hasMasks(job: Job): boolean {
  return job.kind === "train" || job.kind === "prepare";
}

function masksLink(sceneId: string): HTMLElement {
  return h("a", { class: "button", href: masksAddress(sceneId) }, texts.job.masks);
}

function faultNotice(job: Job): HTMLElement[] {
  if (job.error === null || job.state === "succeeded") return [];
  const role = job.state === "failed" ? "alert" : null;
  return [
    h(
      "div",
      { class: "notice bad", role },
      h("b", {}, job.state === "failed" ? texts.job.failed : texts.job.lastRunFailed),
      ` ${job.error.message} `,
      h("code", { class: "faint" }, job.error.code),
    ),
  ];
}
