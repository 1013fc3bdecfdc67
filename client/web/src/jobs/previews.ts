/** The pictures that a run has sent: the object turns while it learns, and every earlier picture has its place. */

import { blobAddress } from "../page/addresses.js";
import { h, setText } from "../page/dom.js";
import type { Part } from "./live.js";
import type { JobRecord, Preview } from "./store.js";
import { fillIn, named, texts } from "../words/words.js";

/** Begins the names of pictures between which the camera has moved on by a step. */
const turning = "turning_";
/** A turn in steps of the worker's (worker/lambent_run/run/live_preview.py). */
const turnSteps = 24;
const frameMs = 160;

/** Return where in the history the pictures are that make one turn: the newest, at most `turnSteps`. */
export function turnOf(previews: readonly Preview[]): number[] {
  const places = previews.flatMap(({ name }, place) => (name.startsWith(turning) ? [place] : []));
  return places.length < 2 ? [] : places.slice(-turnSteps);
}

/** Return what a picture shows, in words. */
export function previewText(preview: Preview): string {
  if (!preview.name.startsWith(turning)) return preview.name || texts.job.preview;
  return named(texts.stages, preview.name.slice(turning.length));
}

/** The pictures of a run, the turning ones as a film. */
export function previews(): Part & { readonly close: () => void } {
  const images = new Map<string, HTMLImageElement>();
  /** Pictures that the server has let go of since the history was read. */
  const gone = new Set<string>();
  const stack = h("div", { class: "stack" });
  const caption = h("figcaption", { class: "faint" });
  const slider = h("input", { type: "range", min: 0, max: 0, value: 0, "aria-label": texts.job.earlier });
  const play = h("button", { type: "button" }, texts.job.turn);
  const row = h("div", { class: "actions" }, play, slider);
  const element = h("figure", { hidden: true, class: "previews" }, stack, caption, row);
  let shown: JobRecord | null = null;
  let follows = true;
  // Those who asked for little motion start it themselves.
  let turns = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  let frame = 0;

  function imageOf(sha256: string): HTMLImageElement {
    const known = images.get(sha256);
    if (known !== undefined) return known;
    const image = h("img", { alt: "", src: blobAddress(sha256), decoding: "async" });
    image.addEventListener("error", () => leaveOut(sha256, image));
    images.set(sha256, image);
    stack.append(image);
    return image;
  }

  async function leaveOut(sha256: string, image: HTMLImageElement): Promise<void> {
    // A server that is away for a while still has its pictures.
    const answer = await fetch(blobAddress(sha256), { method: "HEAD" }).catch(() => null);
    if (answer?.status !== 404) return;
    gone.add(sha256);
    images.delete(sha256);
    image.remove();
    update();
  }

  function pictures(): Preview[] {
    return (shown?.previews ?? []).filter(({ sha256 }) => !gone.has(sha256));
  }

  function draw(): void {
    const all = pictures();
    const turn = turns ? turnOf(all) : [];
    const place = turn.length > 0 ? turn[frame % turn.length]! : Number(slider.value);
    const preview = all[Math.min(place, all.length - 1)];
    if (preview === undefined) return;
    // What is loaded stays, so that the film does not flicker; the rest of the history goes.
    const kept = new Set([preview, ...turn.map((each) => all[each]!)].map(({ sha256 }) => sha256));
    for (const sha256 of kept) imageOf(sha256);
    const now = imageOf(preview.sha256);
    for (const [sha256, image] of images) {
      if (!kept.has(sha256)) {
        images.delete(sha256);
        image.remove();
      } else image.classList.toggle("on", image === now);
    }
    const text = previewText(preview);
    now.alt = fillIn(turn.length > 0 ? texts.job.modelTurning : texts.job.model, { stage: text });
    for (const image of images.values()) if (image !== now) image.alt = "";
    setText(
      caption,
      turn.length > 0
        ? fillIn(texts.job.newestPreviews, { stage: text, turn: turn.length, all: all.length })
        : fillIn(texts.job.previewOf, { stage: text, place: place + 1, all: all.length }),
    );
  }

  slider.addEventListener("input", () => {
    turns = false;
    follows = Number(slider.value) === Number(slider.max);
    update();
  });
  play.addEventListener("click", () => {
    turns = !turns;
    update();
  });
  const timer = setInterval(() => {
    if (!turns || document.hidden || !element.isConnected) return;
    frame += 1;
    draw();
  }, frameMs);

  function update(): void {
    const all = pictures();
    const last = all.length - 1;
    element.hidden = last < 0;
    slider.hidden = last < 1;
    slider.max = String(Math.max(last, 0));
    if (follows) slider.value = slider.max;
    play.hidden = turnOf(all).length === 0;
    setText(play, turns ? texts.job.pause : texts.job.turn);
    draw();
  }

  return {
    element,
    update: (record) => {
      shown = record;
      update();
    },
    close: () => clearInterval(timer),
  };
}
