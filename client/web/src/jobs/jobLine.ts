/** A job in a list, and its summary in a line. */

import { jobAddress } from "../page/addresses.js";
import { arrange, h, replaceKeyed, setText } from "../page/dom.js";
import { formatDuration, formatNumber, formatTime } from "../page/format.js";
import { isFinal, type Job } from "../page/rest.js";
import { thumbnail } from "../page/thumbnail.js";
import { stateLabel } from "./view.js";
import { fillIn, named, texts } from "../words/words.js";

/** The stages of a training, in their order. */
export const stages = ["cameras", "ingest", "masks", "cache", "joint", "polish", "evaluate", "export"];

/** Return a description of a job's work. */
export function purpose(job: Job): string {
  return job.kind === "train"
    ? fillIn(texts.jobs.preset, { name: job.preset })
    : named(texts.jobs.purposes, job.kind);
}

/** Return whether lists show a job: checks belong to their scene, and corrections to the editor of masks. */
export function isListed(job: Job): boolean {
  return job.kind !== "check" && (job.kind !== "prepare" || job.params.corrections === undefined);
}

/** Return a job's name in lists: that of its scene, if it has one. */
export function jobName(job: Job): string {
  return job.scene_name || job.scene_id || purpose(job);
}

/** Return the duration or progress of a job; empty if unknown. */
export function progressText(job: Job): string {
  if (isFinal(job)) {
    if (job.started_at === null || job.finished_at === null) return "";
    return fillIn(texts.jobs.took, {
      time: formatDuration((Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000),
    });
  }
  const { progress } = job;
  if (progress === null) return "";
  const parts = [named(texts.stages, progress.stage)];
  if (progress.num_steps > 1)
    parts.push(
      fillIn(texts.jobs.step, {
        doing: progress.doing || texts.jobs.aStep,
        step: progress.step,
        steps: progress.num_steps,
      }),
    );
  if (progress.psnr > 0) parts.push(`PSNR ${formatNumber(progress.psnr, 1)} dB`);
  if (progress.eta_s > 0) parts.push(fillIn(texts.jobs.toGo, { time: formatDuration(progress.eta_s) }));
  return parts.join(" · ");
}

/** Return the share of a job that is done. */
export function fractionDone(job: Job): number {
  return job.state === "succeeded" ? 1 : (job.progress?.fraction ?? 0);
}

/** A card of a list that is changed in place, so that focus stays where it is. */
export function jobLine(first: Job, name: string): { element: HTMLLIElement; update: (job: Job) => void } {
  const state = h("span");
  const bar = h("progress", { max: 1, "aria-label": texts.jobs.share });
  const figures = h("p", { class: "figures" });
  const picture = thumbnail();
  const element = h(
    "li",
    { class: "card pictured" },
    picture.element,
    h(
      "div",
      {},
      h("div", { class: "line" }, h("h3", {}, h("a", { href: jobAddress(first.id) }, name)), state),
      h("p", { class: "faint" }, `${purpose(first)} · ${formatTime(first.created_at)}`),
      bar,
      figures,
    ),
  );
  const update = (job: Job) => {
    replaceKeyed(state, job.state, () => [stateLabel(job.state)]);
    bar.value = fractionDone(job);
    bar.hidden = isFinal(job) || job.state === "queued";
    setText(figures, progressText(job));
    figures.hidden = figures.textContent === "";
    picture.show(job.thumbnail_url);
  };
  update(first);
  return { element, update };
}

/** Update a list of jobs; jobs that stay in place keep their element. */
export function jobList(label: string, nameOf: (job: Job) => string) {
  const element = h("ol", { class: "list", "aria-label": label });
  const lines = new Map<string, ReturnType<typeof jobLine>>();
  const update = (jobs: readonly Job[]) => {
    for (const job of jobs) {
      const known = lines.get(job.id);
      if (known === undefined) lines.set(job.id, jobLine(job, nameOf(job)));
      else known.update(job);
    }
    arrange(
      element,
      jobs.map(({ id }) => lines.get(id)!.element),
    );
    element.hidden = jobs.length === 0;
  };
  return { element, update };
}
