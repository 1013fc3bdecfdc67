/** The editor of masks: all photographs, one of them large, and the marks. */

import { h, section, setText } from "../page/dom.js";
import { formatNumber, formatPercent } from "../page/format.js";
import { Applier, type ApplyState } from "./applier.js";
import type { Applied, Capture, Frame, MaskBackend } from "./backend.js";
import { documentOf, History } from "./corrections.js";
import { doubtfulFirst, Grid } from "./grid.js";
import { Pad } from "./pad.js";
import { toolControls } from "./tools.js";
import { fillIn, texts } from "../words/words.js";

export type EditorContext = {
  readonly backend: MaskBackend;
  /** Report a problem. */
  readonly fail: (error: unknown) => void;
  /** The last problem is over. */
  readonly recovered?: () => void;
  /** The text of the button that ends the editing. */
  readonly finishLabel: string;
  /** Called at the end with how to continue, as `MaskBackend.finish` returns it. */
  readonly finished: (next: string) => void;
};

export type Editor = { readonly element: HTMLElement; readonly close: () => void };

const largeSide = 1600;

/** Return in words how well the views agree on the masks. */
export function agreementText(agreement: number, reason: string, marked: boolean): string {
  if (reason !== "" && !marked) {
    return fillIn(texts.masks.notFound, { reason });
  }
  return fillIn(texts.masks.agree, { share: formatPercent(agreement) });
}

/** Return the outcome of the last change in words. */
export function appliedText(applied: Applied, frames: number, seconds: number): string {
  const changed =
    applied.changed.length === 0
      ? texts.masks.unchanged
      : fillIn(texts.masks.changed, { n: applied.changed.length });
  const agree = fillIn(texts.masks.agree, { share: formatPercent(applied.agreement) });
  return fillIn(texts.masks.applied, { frames, seconds: formatNumber(seconds, 1), changed, agree });
}

/** Load the capture and return the editor. */
export async function maskEditor(context: EditorContext): Promise<Editor> {
  return new MaskEditor(context, await context.backend.load());
}

class MaskEditor implements Editor {
  readonly element: HTMLElement;
  readonly #frames: readonly Frame[];
  readonly #history: History;
  readonly #applier: Applier;
  readonly #grid: Grid;
  readonly #pad: Pad;
  readonly #controls = toolControls({ label: "background", shape: "brush", brush: 55 }, () =>
    this.#pad.draw(),
  );
  readonly #status = h("p", { class: "figures", role: "status" });
  readonly #heading = h("h2", { tabindex: -1 });
  readonly #undo = button(texts.page.undo, texts.masks.undoKey, () => this.#takeBack());
  readonly #clear = button(texts.masks.clear, "", () => this.#clearOpen());
  readonly #large: HTMLElement;
  readonly #over = new AbortController();
  #open: Frame | null = null;
  #doubtful: ReadonlySet<string>;
  #ticking: ReturnType<typeof setInterval> | undefined;
  /** Number of requests for the open mask; only the answer to the last one is shown. */
  #masksAsked = 0;

  constructor(
    private readonly context: EditorContext,
    capture: Capture,
  ) {
    const { backend, finishLabel } = context;
    this.#frames = doubtfulFirst(capture.frames);
    this.#doubtful = new Set(capture.frames.filter((each) => each.doubtful).map((each) => each.name));
    this.#history = new History(capture.corrections.corrections);
    this.#applier = new Applier(
      (corrections, signal) => backend.apply(documentOf(corrections), signal),
      (state) => this.#told(state),
    );
    this.#grid = new Grid(backend, this.#frames, (frame) => this.#show(frame));
    this.#pad = new Pad({
      tools: () => this.#controls.tools,
      choose: (tools) => this.#controls.choose(tools),
      mark: (correction) => {
        this.#history.add(correction);
        this.#changed();
      },
      leave: () => this.#hide(),
      turn: (step) => this.#turn(step),
      say: (text) => setText(this.#status, text),
    });
    this.#large = this.#largeView();
    const finish = h("button", { type: "button", class: "first" }, finishLabel);
    finish.addEventListener("click", () => void this.#finish(finish));
    this.element = h(
      "div",
      { class: "masks" },
      h("p", {}, texts.masks.about),
      h("div", { class: "actions bar" }, finish, this.#undo, this.#status),
      this.#large,
      section(texts.masks.all, {}, this.#grid.element),
    );
    setText(
      this.#status,
      agreementText(capture.agreement, capture.reason, capture.corrections.corrections.length > 0),
    );
    document.addEventListener("keydown", (event) => this.#key(event), { signal: this.#over.signal });
    this.#label();
    this.#draw(this.#frames.map((each) => each.name));
  }

  close(): void {
    this.#applier.stop();
    this.#over.abort();
    this.#open = null;
    this.#pad.clear();
    this.#grid.close();
    clearInterval(this.#ticking);
  }

  #largeView(): HTMLElement {
    const zoom = (text: string, name: string, act: () => void) => {
      const element = button(text, "", act);
      element.setAttribute("aria-label", name);
      return element;
    };
    const help = h("p", { class: "faint help" }, texts.masks.help);
    return h(
      "section",
      { class: "large", hidden: true, "aria-label": texts.masks.one },
      h(
        "div",
        { class: "line" },
        this.#heading,
        h(
          "div",
          { class: "actions" },
          zoom("◀", texts.masks.before, () => this.#turn(-1)),
          zoom("▶", texts.masks.next, () => this.#turn(1)),
          button(texts.page.close, texts.masks.closeKey, () => this.#hide()),
        ),
      ),
      this.#controls.element,
      this.#pad.element,
      h(
        "div",
        { class: "actions" },
        zoom("+", texts.masks.zoomIn, () => this.#pad.zoom(1.4)),
        zoom("−", texts.masks.zoomOut, () => this.#pad.zoom(1 / 1.4)),
        button(texts.masks.whole, "0", () => this.#pad.whole()),
        this.#clear,
      ),
      help,
    );
  }

  #show(frame: Frame): void {
    this.#open = frame;
    this.#large.hidden = false;
    this.#heading.textContent = frame.name;
    this.#grid.current(frame.name);
    this.#pad.open(frame);
    this.#pad.marks(this.#history.of(frame.name));
    this.#label();
    this.#large.scrollIntoView({ block: "nearest" });
    this.#pad.element.focus({ preventScroll: true });
    const { backend } = this.context;
    const picture = async () => {
      const bitmap = await createImageBitmap(await backend.picture(frame.name, largeSide));
      if (this.#open === frame) this.#pad.picture(bitmap);
      else bitmap.close();
    };
    Promise.all([picture(), this.#drawOpen()]).catch(this.context.fail);
  }

  async #drawOpen(): Promise<void> {
    const frame = this.#open;
    if (frame === null) return;
    this.#masksAsked += 1;
    const mine = this.#masksAsked;
    const mask = await createImageBitmap(await this.context.backend.mask(frame.name));
    if (this.#masksAsked === mine) this.#pad.mask(mask);
    mask.close();
  }

  #hide(): void {
    const frame = this.#open;
    if (frame === null) return;
    this.#pad.cancel();
    this.#pad.clear();
    this.#open = null;
    this.#large.hidden = true;
    this.#grid.current(null);
    this.#grid.focus(frame.name);
  }

  #turn(step: number): void {
    if (this.#open === null) return;
    const count = this.#frames.length;
    this.#show(this.#frames[(this.#frames.indexOf(this.#open) + step + count) % count]!);
  }

  #takeBack(): void {
    if (this.#pad.cancel() || !this.#history.canUndo) return;
    const frames = this.#history.undo();
    this.#changed();
    setText(this.#status, fillIn(texts.masks.undone, { frames: [...frames].join(", ") }));
  }

  #clearOpen(): void {
    if (this.#open === null) return;
    this.#history.clear(this.#open.name);
    this.#changed();
  }

  #key(event: KeyboardEvent): void {
    if (!(event.ctrlKey || event.metaKey) || event.shiftKey || event.key.toLowerCase() !== "z") return;
    event.preventDefault();
    this.#takeBack();
  }

  #changed(): void {
    if (this.#open !== null) this.#pad.marks(this.#history.of(this.#open.name));
    this.#label();
    setText(this.#status, texts.masks.noted);
    this.#applier.change(this.#history.now);
  }

  #label(): void {
    this.#grid.label(this.#doubtful, (name) => this.#history.of(name).length);
    this.#undo.disabled = !this.#history.canUndo;
    this.#clear.disabled = this.#open === null || this.#history.of(this.#open.name).length === 0;
  }

  #told(state: ApplyState): void {
    clearInterval(this.#ticking);
    this.element.setAttribute("aria-busy", String(state.kind === "applying"));
    if (state.kind === "failed") {
      setText(this.#status, texts.masks.notCarried);
      this.context.fail(state.error);
      return;
    }
    this.context.recovered?.();
    if (state.kind === "applying") {
      const began = performance.now();
      const text = fillIn(texts.masks.carrying, { frames: this.#frames.length });
      setText(this.#status, text);
      this.#ticking = setInterval(() => {
        setText(
          this.#status,
          fillIn(texts.masks.seconds, { text, seconds: Math.round((performance.now() - began) / 1000) }),
        );
      }, 1000);
      return;
    }
    const { applied, seconds } = state;
    this.#doubtful = new Set(applied.doubtful);
    this.#label();
    setText(this.#status, appliedText(applied, this.#frames.length, seconds));
    this.#draw(applied.changed);
  }

  /** Draw the masks of some frames, that of the open one first. */
  #draw(names: readonly string[]): void {
    const open = this.#open !== null && names.includes(this.#open.name) ? this.#drawOpen() : null;
    Promise.resolve(open)
      .then(() => this.#grid.draw(names))
      .then(() => {
        this.element.dataset.drawn = String(performance.now());
      })
      .catch(this.context.fail);
  }

  async #finish(finish: HTMLButtonElement): Promise<void> {
    finish.disabled = true;
    this.#applier.stop();
    try {
      const next = await this.context.backend.finish(documentOf(this.#history.now));
      this.close();
      this.context.finished(next);
    } catch (error) {
      finish.disabled = false;
      this.context.fail(error);
    }
  }
}

function button(text: string, key: string, act: () => void): HTMLButtonElement {
  return h(
    "button",
    { type: "button", title: key === "" ? null : fillIn(texts.page.key, { key }), onclick: act },
    text,
  );
}
