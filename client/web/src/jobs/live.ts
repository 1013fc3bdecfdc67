/** The live view of a running job: stages, pictures, curves. */

import { h, setText, svg } from "../page/dom.js";
import { formatDuration, formatNumber } from "../page/format.js";
import type { Job } from "../page/rest.js";
import { chart, thinned } from "./curves.js";
import { stages } from "./jobLine.js";
import type { JobRecord, Sample } from "./store.js";
import { fillIn, named, texts } from "../words/words.js";

const width = 400;
const height = 100;
const maxSamples = 240;

export type Part = { readonly element: HTMLElement; readonly update: (record: JobRecord) => void };
export type StageState = "done" | "now" | "waiting";

/** Return the state of each stage of a job, in their order. */
export function stageStates(job: Job): [string, StageState][] {
  if (job.state === "succeeded") return stages.map((name) => [name, "done"]);
  const now = stages.indexOf(job.progress?.stage ?? "");
  return stages.map((name, place) => [name, place < now ? "done" : place === now ? "now" : "waiting"]);
}

/** Return the time a stage has taken so far, in seconds; null where that is not known. */
export function stageSeconds(record: JobRecord, stage: string): number | null {
  const began = record.stages.get(stage);
  if (began === undefined) return null;
  const later = [...record.stages.values()].filter((at) => at > began);
  const finished = record.job.finished_at;
  const end = later.length > 0 ? Math.min(...later) : finished === null ? null : Date.parse(finished) / 1000;
  return end === null ? null : Math.max(end - began, 0);
}

/** The list of stages, each with its own bar. */
export function stageList(): Part {
  const rows = stages.map((stage) => {
    const name = named(texts.stages, stage);
    const mark = h("span", { "aria-hidden": "true" });
    const hidden = h("span", { class: "sr" });
    const text = h("span", {}, name, hidden);
    const time = h("span", { class: "figures" });
    const bar = h("progress", {
      max: 1,
      value: 0,
      "aria-label": fillIn(texts.job.stageProgress, { stage: name }),
    });
    return { stage, mark, hidden, time, bar, element: h("li", {}, mark, text, time, bar) };
  });
  const marks: Record<StageState, string> = { done: "✓", now: "▸", waiting: "·" };
  const words: Record<StageState, string> = {
    done: texts.job.stageDone,
    now: "",
    waiting: texts.job.stageToCome,
  };
  return {
    element: h("ol", { class: "stages", "aria-label": texts.job.stages }, ...rows.map((row) => row.element)),
    update: (record) => {
      const states = new Map(stageStates(record.job));
      const { progress } = record.job;
      for (const row of rows) {
        const state = states.get(row.stage) ?? "waiting";
        row.element.dataset.state = state;
        setText(row.mark, marks[state]);
        setText(row.hidden, words[state]);
        row.bar.hidden = state !== "now";
        if (state === "now" && progress !== null) {
          row.bar.value = progress.num_steps > 0 ? progress.step / progress.num_steps : 0;
          const { doing, step, num_steps: all, steps_per_s: speed } = progress;
          const parts = [];
          if (all > 1)
            parts.push(fillIn(texts.page.of, { part: `${doing} ${step}`.trim(), whole: String(all) }));
          if (speed > 0) parts.push(fillIn(texts.job.perSecond, { speed: formatNumber(speed, 1) }));
          setText(row.time, parts.join(" · "));
        } else {
          const seconds = stageSeconds(record, row.stage);
          setText(row.time, state === "done" && seconds !== null ? formatDuration(seconds) : "");
        }
      }
    },
  };
}

/**
 * PSNR of each stage in a plot of its own, and the losses a click away.
 *
 * The stages render different things (the cache; materials and light), so the second begins lower, which would look
 * like a failure in one plot.
 */
export function curves(): Part {
  const element = h("div", { class: "charts" });
  const losses = h("div", { class: "charts" });
  const folded = h("details", { hidden: true }, h("summary", {}, texts.job.losses), losses);
  const plots = new Map<string, ReturnType<typeof plot>>();
  const plotOf = (kind: "psnr" | "loss", stage: string) => {
    const key = `${kind} ${stage}`;
    let found = plots.get(key);
    if (found === undefined) {
      const title = titleOf(stage);
      found =
        kind === "psnr"
          ? plot(fillIn(texts.job.psnrOf, { stage: title }), "dB", 1, false)
          : plot(fillIn(texts.job.lossOf, { stage: title }), "", 4, true);
      plots.set(key, found);
      if (kind === "psnr") element.insertBefore(found.element, folded);
      else losses.append(found.element);
    }
    return found;
  };
  element.append(folded);
  return {
    element,
    update: (record) => {
      for (const kind of ["psnr", "loss"] as const) {
        for (const [stage, samples] of Map.groupBy(record[kind], (sample) => sample.stage)) {
          plotOf(kind, stage).update(samples);
        }
      }
      folded.hidden = record.loss.length < 2;
    },
  };
}

function titleOf(stage: string): string {
  const name = named(texts.stages, stage);
  return name.charAt(0).toUpperCase() + name.slice(1);
}

function plot(name: string, unit: string, digits: number, logarithmic: boolean) {
  const line = svg("polyline");
  const box = { viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none" };
  const picture = svg("svg", { ...box, role: "img", class: "chart" }, line);
  const caption = h("figcaption", { class: "faint" });
  const element = h("figure", { hidden: true }, caption, picture);
  const number = (value: number) => `${formatNumber(value, digits)}${unit === "" ? "" : ` ${unit}`}`;
  const update = (samples: readonly Sample[]) => {
    const drawn = chart(thinned(samples, maxSamples), width, height, logarithmic);
    element.hidden = drawn === null;
    if (drawn === null) return;
    const now = samples.at(-1)!.value;
    const range = fillIn(texts.page.range, { from: number(drawn.lowest), to: number(drawn.highest) });
    setText(
      caption,
      fillIn(texts.job.plot, { name, now: number(now), range, time: formatDuration(drawn.spanS) }),
    );
    picture.setAttribute("aria-label", fillIn(texts.job.plotLabel, { name, now: number(now), range }));
    line.setAttribute("points", drawn.points);
  };
  return { element, update };
}
