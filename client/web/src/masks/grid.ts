/** All photographs, small, with their masks. */

import { h, setText } from "../page/dom.js";
import { inLines } from "../page/rest.js";
import type { Frame, MaskBackend } from "./backend.js";
import { drawThumbnail } from "./paint.js";
import { fillIn, texts } from "../words/words.js";

const thumbnailSide = 240;
/** Requests that are under way at once. */
const lines = 6;

/** Return the frames with the doubtful ones first. */
export function doubtfulFirst(frames: readonly Frame[]): Frame[] {
  return [...frames.filter((each) => each.doubtful), ...frames.filter((each) => !each.doubtful)];
}

/** Return the words for a photograph's state. */
export function badge(doubtful: boolean, marks: number): string {
  return [doubtful && texts.masks.doubtful, marks > 0 && fillIn(texts.masks.marks, { n: marks })]
    .filter(Boolean)
    .join(", ");
}

type Cell = {
  readonly canvas: HTMLCanvasElement;
  readonly button: HTMLButtonElement;
  readonly state: HTMLElement;
  picture: ImageBitmap | null;
  asked: number;
};

export class Grid {
  readonly element = h("ol", { class: "shots", "aria-label": texts.masks.all });
  readonly #cells = new Map<string, Cell>();
  #isClosed = false;

  constructor(
    private readonly backend: MaskBackend,
    frames: readonly Frame[],
    open: (frame: Frame) => void,
  ) {
    for (const frame of frames) {
      const canvas = h("canvas", { width: 3, height: 2, "aria-hidden": "true" });
      const state = h("span", { class: "badge" });
      const name = h("span", { class: "name" }, frame.name);
      const button = h("button", { type: "button", onclick: () => open(frame) }, canvas, name, state);
      this.#cells.set(frame.name, { canvas, button, state, picture: null, asked: 0 });
      this.element.append(h("li", {}, button));
    }
  }

  /** Fetch masks, and pictures where they are missing, and draw them. */
  async draw(names: readonly string[]): Promise<void> {
    await inLines(lines, names, async (name) => {
      const cell = this.#cells.get(name)!;
      cell.asked += 1;
      const mine = cell.asked;
      const [mask] = await Promise.all([
        this.backend.mask(name).then((blob) => createImageBitmap(blob)),
        this.#load(name, cell),
      ]);
      // A later request may have been answered first.
      if (cell.asked === mine && cell.picture !== null) drawThumbnail(cell.canvas, cell.picture, mask);
      mask.close();
    });
  }

  /** Free the pictures; what was drawn stays. */
  close(): void {
    this.#isClosed = true;
    for (const cell of this.#cells.values()) {
      cell.picture?.close();
      cell.picture = null;
    }
  }

  async #load(name: string, cell: Cell): Promise<void> {
    if (cell.picture !== null) return;
    const picture = await createImageBitmap(await this.backend.picture(name, thumbnailSide));
    if (this.#isClosed || cell.picture !== null) picture.close();
    else cell.picture = picture;
  }

  /** Say which photographs are doubtful and how many marks are on each. */
  label(doubtful: ReadonlySet<string>, marks: (name: string) => number): void {
    for (const [name, cell] of this.#cells) {
      cell.state.dataset.doubtful = String(doubtful.has(name));
      setText(cell.state, badge(doubtful.has(name), marks(name)));
    }
  }

  /** Show which photograph is open. */
  current(name: string | null): void {
    for (const [each, { button }] of this.#cells) {
      if (each === name) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    }
  }

  focus(name: string): void {
    this.#cells.get(name)?.button.focus();
  }
}
