/** One job: live while it runs, its results when it is done. */

import { button } from "../page/actions.js";
import { jobAddress, masksAddress, sceneAddress } from "../page/addresses.js";
import { h, replaceKeyed, section, setText } from "../page/dom.js";
import { formatDuration, formatTime } from "../page/format.js";
import type { Job } from "../page/rest.js";
import { fractionDone, jobName, progressText, purpose } from "./jobLine.js";
import { curves, stageList } from "./live.js";
import { logView } from "./log.js";
import { previews } from "./previews.js";
import { resultSection } from "./results.js";
import { isFinal } from "./store.js";
import { type Context, stateLabel, type View } from "./view.js";
import { fillIn, named, texts } from "../words/words.js";

/** Return the page of a job. */
export async function jobView(context: Context, jobId: string): Promise<View> {
  const { api, store, fail } = context;
  await store.loadHistory(jobId);
  const first = store.get(jobId)!.job;
  // A scene that was removed has no name any more, and some jobs have none; the jobs stay.
  const scene = first.scene_id === "" ? null : await api.scene(first.scene_id).catch(() => null);
  const name = jobName(first);

  const state = h("span");
  const news = h("p", { class: "sr", role: "status" });
  const bar = h("progress", { max: 1, "aria-label": texts.jobs.share });
  const figures = h("p", { class: "figures" });
  const fault = h("div");
  const parts = [stageList(), previews(), curves()] as const;
  const [stages, pictures, plots] = parts;
  const results = h("div");
  const log = logView(context, jobId);
  const cancel = button(texts.page.cancel, context, async () => store.put(await api.cancel(jobId)));
  const retry = button(texts.job.runAgain, context, async () => {
    const fresh = await api.retry(jobId);
    store.put(fresh);
    location.hash = jobAddress(fresh.id);
  });

  const remove = button(texts.job.delete, context, async () => {
    context.removals.ask({
      id: jobId,
      what: fillIn(texts.job.theJob, { name }),
      send: (keepalive) => api.deleteJob(jobId, keepalive),
      gone: () => store.forget(jobId),
    });
    location.hash = "#/";
  });

  function draw(): void {
    const record = store.get(jobId);
    if (record === undefined) return;
    const { job } = record;
    replaceKeyed(state, job.state, () => [stateLabel(job.state)]);
    setText(news, fillIn(texts.job.news, { state: named(texts.states, job.state) }));
    bar.value = fractionDone(job);
    bar.hidden = isFinal(job);
    setText(figures, statusText(job));
    replaceKeyed(fault, JSON.stringify([job.error, job.state]), () => faultNotice(job));
    stages.element.hidden = job.kind !== "train" || job.started_at === null;
    for (const part of parts) part.update(record);
    cancel.hidden = isFinal(job) || job.state === "cancelling";
    remove.hidden = !isFinal(job);
    retry.hidden = job.state !== "failed" && job.state !== "cancelled";
    replaceKeyed(results, `${job.state} ${job.bundle_id}`, () => [resultSection(context, job, name)]);
    log.update(job);
  }
  const live = h("div", { class: "live" }, pictures.element, plots.element);
  const progressed = isFinal(first)
    ? h("details", { class: "fold" }, h("summary", {}, texts.job.history), live, stages.element)
    : section(texts.job.progress, {}, live, stages.element);
  draw();

  return {
    title: `${name}: ${purpose(first)}`,
    element: h(
      "div",
      {},
      h("p", {}, h("a", { href: "#/" }, texts.start.allJobs)),
      h("h1", { tabindex: -1 }, name, " ", state),
      news,
      h(
        "p",
        { class: "faint" },
        `${purpose(first)} · ${formatTime(first.created_at)}`,
        scene !== null && " · ",
        scene !== null && h("a", { href: sceneAddress(scene.id) }, texts.job.scene),
      ),
      bar,
      figures,
      fault,
      h("div", { class: "actions" }, cancel, retry, scene !== null && hasMasks(first) && masksLink(scene.id)),
      results,
      progressed,
      log.element,
      h("section", { "aria-label": texts.job.section }, h("div", { class: "actions" }, remove)),
    ),
    update: (changed) => {
      if (changed === null) store.loadHistory(jobId).catch(fail);
      else if (changed === jobId) draw();
    },
    close: () => {
      log.close();
      pictures.close();
    },
  };
}

/** Return the line below the bar. */
export function statusText(job: Job): string {
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
