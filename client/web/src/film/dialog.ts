/** The dialog that makes films; loaded when it is first opened. */

import { messageOf } from "../page/fault.js";
import { formatSize } from "../page/format.js";
import { WorkNews } from "../viewer/dialogs.js";
import { button, check, choice, type Field, make } from "../viewer/fields.js";
import { download } from "../viewer/save.js";
import type { Viewer } from "../viewer/viewer.js";
import { codecFor, codecNames } from "./encoder.js";
import { makeFilm } from "./film.js";
import {
  defaultPlan,
  type FilmFormat,
  type FilmPlan,
  filmFormats,
  frameCount,
  motions,
  planned,
} from "./plan.js";
import { fillIn, texts } from "../words/words.js";

const sizes = {
  "1080p": [1920, 1080],
  "720p": [1280, 720],
  square: [1080, 1080],
  custom: [0, 0],
} as const;
type SizeName = keyof typeof sizes;

const formatTexts: Readonly<Record<FilmFormat, string>> = { mp4: "MP4", webm: "WebM" };

/** The fields of a plan; `changed` is called with every choice. */
class PlanFields {
  readonly element: HTMLFieldSetElement;
  plan: FilmPlan = defaultPlan;
  #size: SizeName = "1080p";
  readonly #codecs = new Map<FilmFormat, string>();
  readonly #followers: (() => void)[] = [];
  readonly #formats = choice(
    texts.film.format,
    () =>
      filmFormats.map(
        (format) => [format, `${formatTexts[format]}${this.#codecs.get(format) ?? ""}`] as const,
      ),
    (format) => this.#change({ format }),
  );
  readonly #ownSize = [
    this.#number(texts.film.width, "width", "2"),
    this.#number(texts.film.height, "height", "2"),
  ];

  constructor(private readonly changed: () => void) {
    const motion = choice(
      texts.film.motion,
      () => motions.map((each) => [each, texts.film.motions[each]] as const),
      (each) => this.#change({ motion: each }),
    );
    const size = choice(
      texts.film.size,
      () => (Object.keys(sizes) as SizeName[]).map((name) => [name, texts.film.sizes[name]] as const),
      (name) => {
        this.#size = name;
        const [width, height] = sizes[name];
        this.#change(name === "custom" ? {} : { width, height });
      },
    );
    const loop = check(texts.film.loop, (on) => this.#change({ loop: on }));
    this.element = make(
      "fieldset",
      { className: "fields" },
      this.#follow(motion, () => this.plan.motion),
      this.#follow(size, () => this.#size),
      ...this.#ownSize,
      this.#number(texts.film.seconds, "seconds", "0.1"),
      this.#number(texts.film.framesPerSecond, "framesPerSecond", "1"),
      this.#follow(this.#formats, () => this.plan.format),
      this.#follow(loop, () => this.plan.loop),
    );
  }

  show(): void {
    for (const each of this.#ownSize) each.hidden = this.#size !== "custom";
    for (const each of this.#followers) each();
  }

  /** Name the codec of each format at this size. */
  async learnCodecs(): Promise<void> {
    for (const format of filmFormats) {
      const text = await codecFor(format, this.plan).then(
        (codec) => ` (${codecNames[codec]})`,
        () => texts.film.noCodec,
      );
      this.#codecs.set(format, text);
    }
    this.#formats.refill();
    this.#formats.show(this.plan.format);
  }

  #change(part: Partial<FilmPlan>): void {
    this.plan = { ...this.plan, ...part };
    this.changed();
  }

  #follow<T>(field: Field<T>, value: () => T): HTMLElement {
    this.#followers.push(() => field.show(value()));
    return field.element;
  }

  #number(label: string, name: "width" | "height" | "seconds" | "framesPerSecond", step: string) {
    const entry = make("input", { type: "number", min: "0", step });
    entry.addEventListener("input", () => this.#change({ [name]: entry.valueAsNumber }));
    this.#followers.push(() => {
      if (!Object.is(entry.valueAsNumber, this.plan[name])) entry.value = String(this.plan[name]);
    });
    return make("label", {}, label, entry);
  }
}

/** The dialog of a viewer; `during` keeps that drawing while a film is made. */
export class FilmDialog {
  readonly element: HTMLDialogElement;
  readonly #fields = new PlanFields(() => this.#draw());
  readonly #told = new WorkNews();
  readonly #bar = make("progress", { hidden: true, ariaLabel: texts.film.framesMade });
  readonly #preview = make("canvas", { hidden: true, ariaLabel: texts.film.lastFrame });
  readonly #start = make("button", { type: "submit", textContent: texts.film.make });
  readonly #close = button(texts.page.close, () => {
    if (this.#running === null) this.element.close();
    else this.#running.abort(new DOMException("the film was cancelled", "AbortError"));
  });
  #running: AbortController | null = null;

  constructor(
    private readonly viewer: Viewer,
    private readonly during: <T>(work: () => Promise<T>) => Promise<T>,
  ) {
    const form = make(
      "form",
      { method: "dialog", noValidate: true },
      this.#fields.element,
      this.#preview,
      this.#bar,
      this.#told.count,
      this.#told.news,
      make("div", { className: "buttons" }, this.#close, this.#start),
    );
    this.element = make(
      "dialog",
      { className: "work", ariaLabel: texts.film.title },
      make("h2", { textContent: texts.film.title }),
      form,
    );
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.#work();
    });
    this.element.addEventListener("cancel", (event) => {
      if (this.#running === null) return;
      event.preventDefault();
      this.#close.click();
    });
  }

  show(): void {
    if (this.element.open) return;
    this.#preview.hidden = true;
    this.#draw();
    this.element.showModal();
  }

  #draw(): void {
    this.#fields.show();
    this.#describe();
    if (!this.#start.disabled) void this.#fields.learnCodecs();
  }

  /** Say what would be made, or why it cannot be. */
  #describe(): void {
    try {
      const count = frameCount(planned(this.#fields.plan));
      const bare = this.viewer.state.look.background === "transparent";
      const behind = bare ? texts.film.opaque : "";
      this.#told.say(`${fillIn(texts.film.frames, { n: count })}${behind}.`);
      this.#start.disabled = false;
    } catch (error) {
      this.#told.say(messageOf(error), true);
      this.#start.disabled = true;
    }
  }

  #busy(on: boolean): void {
    this.#fields.element.disabled = on;
    this.#start.disabled = on;
    this.#bar.hidden = !on;
    this.#close.textContent = on ? texts.page.cancel : texts.page.close;
  }

  #onFrame(made: number, count: number, rgba: Uint8ClampedArray<ArrayBuffer>): void {
    const { width, height } = this.#fields.plan;
    this.#bar.max = count;
    this.#bar.value = made;
    this.#told.reach(made / count, fillIn(texts.film.frame, { made, all: count }));
    this.#preview.hidden = false;
    if (this.#preview.width !== width || this.#preview.height !== height) {
      Object.assign(this.#preview, { width, height });
    }
    this.#preview.getContext("2d")?.putImageData(new ImageData(rgba, width, height), 0, 0);
  }

  async #work(): Promise<void> {
    const { plan } = this.#fields;
    const running = new AbortController();
    this.#running = running;
    this.#busy(true);
    this.#told.say(texts.film.starting);
    try {
      const { signal } = running;
      const onFrame = this.#onFrame.bind(this);
      const film = await this.during(() => makeFilm(this.viewer, plan, { signal, onFrame }));
      download(film, `${this.viewer.bundle?.name ?? "lambent"}-${plan.motion}.${plan.format}`);
      const frames = fillIn(texts.film.frames, { n: frameCount(plan) });
      this.#told.say(fillIn(texts.film.saved, { frames, size: formatSize(film.size) }));
    } catch (error) {
      if (running.signal.aborted) this.#told.say(texts.film.cancelled);
      else this.#told.say(messageOf(error), true);
    } finally {
      this.#running = null;
      this.#busy(false);
    }
  }
}
