/** The pictures that a run has sent: the object turns during the training, and a slider shows earlier pictures. */

import { blobAddress } from "../page/addresses.js";
import { h, setText } from "../page/dom.js";
import type { Part } from "./live.js";
import type { JobRecord, Preview } from "./store.js";
import { fillIn, named, texts } from "../words/words.js";

/** The prefix of the names of pictures between which the camera has moved by a step. */
const turning = "turning_";
/** Steps of a whole turn (worker/lambent_run/run/live_preview.py). */
const turnSteps = 24;
const frameMs = 160;

/** Return the places in the history of the pictures that make one turn: the newest, at most `turnSteps`. */
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
export class Previews implements Part {
  readonly #images = new Map<string, HTMLImageElement>();
  /** Pictures that the server has deleted since the history was read. */
  readonly #gone = new Set<string>();
  readonly #stack = h("div", { class: "stack" });
  readonly #caption = h("figcaption", { class: "faint" });
  readonly #slider = h("input", {
    type: "range",
    min: 0,
    max: 0,
    value: 0,
    "aria-label": texts.job.earlier,
    oninput: () => this.#choose(),
  });
  readonly #play = h("button", { type: "button", onclick: () => this.#toggle() }, texts.job.turn);
  readonly element = h(
    "figure",
    { hidden: true, class: "previews" },
    this.#stack,
    this.#caption,
    h("div", { class: "actions" }, this.#play, this.#slider),
  );
  #all: readonly Preview[] = [];
  #follows = true;
  // Those who asked for little motion start it themselves.
  #turns = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  #frame = 0;
  readonly #timer = setInterval(() => {
    if (!this.#turns || document.hidden || !this.element.isConnected) return;
    this.#frame += 1;
    this.#draw();
  }, frameMs);

  update(record: JobRecord): void {
    this.#all = record.previews.filter(({ sha256 }) => !this.#gone.has(sha256));
    this.#show();
  }

  close(): void {
    clearInterval(this.#timer);
  }

  #choose(): void {
    this.#turns = false;
    this.#follows = Number(this.#slider.value) === Number(this.#slider.max);
    this.#show();
  }

  #toggle(): void {
    this.#turns = !this.#turns;
    this.#show();
  }

  #show(): void {
    const last = this.#all.length - 1;
    this.element.hidden = last < 0;
    this.#slider.hidden = last < 1;
    this.#slider.max = String(Math.max(last, 0));
    if (this.#follows) this.#slider.value = this.#slider.max;
    this.#play.hidden = turnOf(this.#all).length === 0;
    setText(this.#play, this.#turns ? texts.job.pause : texts.job.turn);
    this.#draw();
  }

  #draw(): void {
    const all = this.#all;
    const turn = this.#turns ? turnOf(all) : [];
    const place = turn.length > 0 ? turn[this.#frame % turn.length]! : Number(this.#slider.value);
    const preview = all[Math.min(place, all.length - 1)];
    if (preview === undefined) return;
    // What is loaded stays, so that the film does not flicker; the rest of the history goes.
    const kept = new Set([preview, ...turn.map((each) => all[each]!)].map(({ sha256 }) => sha256));
    for (const sha256 of kept) this.#imageOf(sha256);
    const now = this.#imageOf(preview.sha256);
    const stage = previewText(preview);
    for (const [sha256, image] of this.#images) {
      if (!kept.has(sha256)) this.#drop(sha256, image);
      image.classList.toggle("on", image === now);
      image.alt = "";
    }
    now.alt = fillIn(turn.length > 0 ? texts.job.modelTurning : texts.job.model, { stage });
    setText(
      this.#caption,
      turn.length > 0
        ? fillIn(texts.job.newestPreviews, { stage, turn: turn.length, all: all.length })
        : fillIn(texts.job.previewOf, { stage, place: place + 1, all: all.length }),
    );
  }

  #imageOf(sha256: string): HTMLImageElement {
    const known = this.#images.get(sha256);
    if (known !== undefined) return known;
    const image = h("img", { alt: "", src: blobAddress(sha256), decoding: "async" });
    image.addEventListener("error", () => this.#leaveOut(sha256, image));
    this.#images.set(sha256, image);
    this.#stack.append(image);
    return image;
  }

  #drop(sha256: string, image: HTMLImageElement): void {
    this.#images.delete(sha256);
    image.remove();
  }

  async #leaveOut(sha256: string, image: HTMLImageElement): Promise<void> {
    // A server that does not answer for a while still has its pictures.
    const answer = await fetch(blobAddress(sha256), { method: "HEAD" }).catch(() => null);
    if (answer?.status !== 404) return;
    this.#gone.add(sha256);
    this.#drop(sha256, image);
    this.#all = this.#all.filter((each) => each.sha256 !== sha256);
    this.#show();
  }
}
