/** The dialog that makes films; loaded when it is first opened. */

import { messageOf } from "../page/fault.js";
import { formatSize } from "../page/format.js";
import { WorkNews } from "../viewer/dialogs.js";
import { button, check, choice, type Field, make } from "../viewer/fields.js";
import { download } from "../viewer/save.js";
import type { Viewer } from "../viewer/viewer.js";
import { codecFor, codecNames } from "./encoder.js";
import { makeFilm } from "./film.js";
import { defaultPlan, type FilmFormat, type FilmPlan, frameCount, motions, planned } from "./plan.js";
import { fillIn, texts } from "../words/words.js";

const sizes = {
  "1080p": [1920, 1080],
  "720p": [1280, 720],
  square: [1080, 1080],
  custom: [0, 0],
} as const;
type SizeName = keyof typeof sizes;

const formatTexts: Readonly<Record<FilmFormat, string>> = { mp4: "MP4", webm: "WebM" };

/** Return the dialog of a viewer; `during` keeps that drawing while a film is made. */
export function filmDialog(
  viewer: Viewer,
  during: <T>(work: () => Promise<T>) => Promise<T>,
): { element: HTMLDialogElement; show: () => void } {
  let plan: FilmPlan = defaultPlan;
  let size: SizeName = "1080p";
  let running: AbortController | null = null;
  const told = new WorkNews();
  const bar = make("progress", { hidden: true, ariaLabel: texts.film.framesMade });
  const preview = make("canvas", { hidden: true, ariaLabel: texts.film.lastFrame });
  const codecs = new Map<FilmFormat, string>();
  const followers: (() => void)[] = [];
  const follow = <T>(field: Field<T>, value: () => T): HTMLElement => {
    followers.push(() => field.show(value()));
    return field.element;
  };
  const change = (part: Partial<FilmPlan>): void => {
    plan = { ...plan, ...part };
    show();
  };
  const number = (label: string, name: "width" | "height" | "seconds" | "framesPerSecond", step: string) => {
    const entry = make("input", { type: "number", min: "0", step });
    entry.addEventListener("input", () => change({ [name]: entry.valueAsNumber }));
    followers.push(() => {
      if (!Object.is(entry.valueAsNumber, plan[name])) entry.value = String(plan[name]);
    });
    return make("label", {}, label, entry);
  };
  const formats = choice(
    texts.film.format,
    () =>
      (Object.keys(formatTexts) as FilmFormat[]).map(
        (format) => [format, `${formatTexts[format]}${codecs.get(format) ?? ""}`] as const,
      ),
    (format) => change({ format }),
  );
  const sizeList = choice(
    texts.film.size,
    () => (Object.keys(sizes) as SizeName[]).map((name) => [name, texts.film.sizes[name]] as const),
    (name) => {
      size = name;
      const [width, height] = sizes[name];
      change(name === "custom" ? {} : { width, height });
    },
  );
  const ownSize = [number(texts.film.width, "width", "2"), number(texts.film.height, "height", "2")];
  const fields = make(
    "fieldset",
    { className: "fields" },
    follow(
      choice(
        texts.film.motion,
        () => motions.map((motion) => [motion, texts.film.motions[motion]] as const),
        (motion) => change({ motion }),
      ),
      () => plan.motion,
    ),
    follow(sizeList, () => size),
    ...ownSize,
    number(texts.film.seconds, "seconds", "0.1"),
    number(texts.film.framesPerSecond, "framesPerSecond", "1"),
    follow(formats, () => plan.format),
    follow(
      check(texts.film.loop, (loop) => change({ loop })),
      () => plan.loop,
    ),
  );
  const start = make("button", { type: "submit", textContent: texts.film.make });
  const close = button(texts.page.close, () => {
    if (running === null) element.close();
    else running.abort(new DOMException("the film was cancelled", "AbortError"));
  });
  const form = make(
    "form",
    { method: "dialog", noValidate: true },
    fields,
    preview,
    bar,
    told.count,
    told.news,
  );
  form.append(make("div", { className: "buttons" }, close, start));
  const element = make("dialog", { className: "work" }, make("h2", { textContent: texts.film.title }), form);
  element.setAttribute("aria-label", texts.film.title);

  const say = (text: string, problem = false): void => told.say(text, problem);
  /** Say what would be made, or why it cannot be. */
  const describe = (): void => {
    try {
      const count = frameCount(planned(plan));
      const bare = viewer.state.look.background === "transparent";
      const behind = bare ? texts.film.opaque : "";
      say(`${fillIn(texts.film.frames, { n: count })}${behind}.`);
      start.disabled = false;
    } catch (error) {
      say(messageOf(error), true);
      start.disabled = true;
    }
  };
  const learnCodecs = async (): Promise<void> => {
    const { width, height, framesPerSecond } = plan;
    for (const format of Object.keys(formatTexts) as FilmFormat[]) {
      const text = await codecFor(format, { width, height, framesPerSecond }).then(
        (codec) => ` (${codecNames[codec]})`,
        () => texts.film.noCodec,
      );
      codecs.set(format, text);
    }
    formats.refill();
    formats.show(plan.format);
  };
  const show = (): void => {
    for (const each of ownSize) each.hidden = size !== "custom";
    for (const each of followers) each();
    describe();
    if (!start.disabled) void learnCodecs();
  };
  const busy = (on: boolean): void => {
    fields.disabled = on;
    start.disabled = on;
    bar.hidden = !on;
    close.textContent = on ? texts.page.cancel : texts.page.close;
  };
  const onFrame = (made: number, count: number, rgba: Uint8ClampedArray<ArrayBuffer>): void => {
    bar.max = count;
    bar.value = made;
    told.reach(made / count, fillIn(texts.film.frame, { made, all: count }));
    preview.hidden = false;
    if (preview.width !== plan.width || preview.height !== plan.height) {
      Object.assign(preview, { width: plan.width, height: plan.height });
    }
    preview.getContext("2d")?.putImageData(new ImageData(rgba, plan.width, plan.height), 0, 0);
  };
  const work = async (): Promise<void> => {
    running = new AbortController();
    busy(true);
    say(texts.film.starting);
    try {
      const { signal } = running;
      const film = await during(() => makeFilm(viewer, plan, { signal, onFrame }));
      download(film, `${viewer.bundle?.name ?? "lambent"}-${plan.motion}.${plan.format}`);
      say(
        fillIn(texts.film.saved, {
          frames: fillIn(texts.film.frames, { n: frameCount(plan) }),
          size: formatSize(film.size),
        }),
      );
    } catch (error) {
      if (running.signal.aborted) say(texts.film.cancelled);
      else say(messageOf(error), true);
    } finally {
      running = null;
      busy(false);
    }
  };
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void work();
  });
  element.addEventListener("cancel", (event) => {
    if (running === null) return;
    event.preventDefault();
    close.click();
  });
  return {
    element,
    show: () => {
      if (element.open) return;
      preview.hidden = true;
      show();
      element.showModal();
    },
  };
}
