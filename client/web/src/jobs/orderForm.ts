/** The form that starts a job: a preset with an estimate of its time, and settings that override it. */

import { button } from "../page/actions.js";
import { jobAddress, masksAddress } from "../page/addresses.js";
import { h, section, setText } from "../page/dom.js";
import { formatAbout } from "../page/format.js";
import { type Estimate, newKey, type Preset } from "../page/rest.js";
import { correctionsOf, correctionsText, latestPrepared } from "../masks/restBackend.js";
import type { Context } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** An invalid line of the settings. */
export class BadSetting extends Error {
  override readonly name = "BadSetting";
}

/** Return the settings of lines such as "stage_two.num_rays=512"; throws BadSetting for any other line. */
export function parseSettings(text: string): Record<string, string> {
  const found: Record<string, string> = {};
  for (const line of text.split("\n").map((each) => each.trim())) {
    if (line === "") continue;
    const match = /^([a-z][a-z0-9_]*(?:\.[a-z][a-z0-9_]*)*)\s*=\s*(.*)$/.exec(line);
    if (match === null) throw new BadSetting(fillIn(texts.order.badSetting, { line }));
    found[match[1]!] = match[2]!;
  }
  return found;
}

/** Return the text about a preset's time. */
export function estimateText(estimate: Estimate): string {
  if (estimate.seconds === null) return texts.order.noTime;
  const about = fillIn(texts.page.about, { time: formatAbout(estimate.seconds) });
  if (estimate.num_measured === 0) return fillIn(texts.order.onHardware, { about });
  return fillIn(texts.order.asMeasured, { about, n: estimate.num_measured });
}

/** Return the form. */
export function orderForm(context: Context, sceneId: string): HTMLElement {
  const { api, store, fail } = context;
  // One press is one job, however often the request is sent.
  let key = newKey();
  const options = h("div", { class: "presets" });
  const queue = h("p", { class: "faint" });
  const seed = h("input", { type: "number", id: "seed", min: 0, max: 2 ** 31 - 1, step: 1, value: 0 });
  const settings = h("textarea", { id: "settings", rows: 3, spellcheck: "false" });
  const corrected = h("input", { type: "checkbox", id: "corrected", checked: true });
  const marks = h("label", { for: "corrected" });
  const corrections = h("p", { hidden: true }, corrected, " ", marks);
  let correctionsGiven = "";
  const start = button(texts.order.start, { ...context, className: "first" }, async () => {
    const preset = options.querySelector<HTMLInputElement>("input:checked")?.value;
    if (preset === undefined) throw new BadSetting(texts.order.noPreset);
    const order = {
      scene_id: sceneId,
      preset,
      seed: Number(seed.value),
      params: {
        ...parseSettings(settings.value),
        ...(correctionsGiven !== "" && corrected.checked ? { corrections: correctionsGiven } : {}),
      },
    };
    const job = await api.submit(order, key);
    key = newKey();
    store.put(job);
    location.hash = jobAddress(job.id);
  });

  async function loadCorrections(): Promise<void> {
    const prepared = await latestPrepared(api, sceneId);
    if (prepared === null) return;
    const list = correctionsOf(prepared);
    correctionsGiven = correctionsText(list);
    corrections.hidden = correctionsGiven === "";
    setText(marks, fillIn(texts.order.corrected, { n: list.corrections.length }));
  }

  async function load(): Promise<void> {
    const [presets, limits] = await Promise.all([api.presets(), api.limits(), loadCorrections()]);
    const estimates = await Promise.all(presets.items.map((preset) => api.estimate(preset.name)));
    options.replaceChildren(
      ...presets.items.map((preset, place) =>
        option(preset, estimates[place]!, preset.gpus <= limits.max_gpus, preset.name === presets.default),
      ),
    );
    const ahead = estimates[0]?.num_ahead ?? 0;
    setText(queue, ahead > 0 ? fillIn(texts.order.ahead, { n: ahead }) : "");
  }
  load().catch(fail);

  return section(
    texts.order.title,
    {},
    h("fieldset", {}, h("legend", {}, texts.order.preset), options),
    h(
      "details",
      {},
      h("summary", {}, texts.order.more),
      h("p", {}, h("label", { for: "seed" }, texts.order.seed), " ", seed),
      h("p", {}, h("label", { for: "settings" }, texts.order.settings), settings),
    ),
    corrections,
    h(
      "div",
      { class: "actions" },
      start,
      h("a", { class: "button", href: masksAddress(sceneId) }, texts.job.masks),
      queue,
    ),
  );
}

function option(preset: Preset, estimate: Estimate, available: boolean, chosen: boolean): HTMLElement {
  const time = available ? estimateText(estimate) : texts.order.noGpu;
  return h(
    "label",
    {},
    h("input", {
      type: "radio",
      name: "preset",
      value: preset.name,
      disabled: !available,
      checked: chosen && available,
    }),
    h(
      "span",
      {},
      h("b", {}, preset.name),
      h("br"),
      h("span", { class: "faint" }, preset.description),
      h("br"),
      h("span", { class: available ? "estimate" : "faint" }, time),
    ),
  );
}
