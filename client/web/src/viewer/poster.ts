/** The picture in place of a viewer that does not draw: while it loads, until it is wanted, or because others draw. */

import { button, make } from "./fields.js";
import { fillIn, texts } from "../words/words.js";

/** A layer above the canvas. */
export class Poster {
  readonly #image = make("img", { alt: "", hidden: true });
  readonly #still = make("canvas", { hidden: true });
  readonly #open: HTMLButtonElement;
  readonly element: HTMLElement;

  /** `open` is called when someone wants to see more than the picture. */
  constructor(open: () => void) {
    this.#open = button(texts.viewer.show3d, open);
    this.element = make("div", { className: "poster" }, this.#image, this.#still, this.#open);
    // A picture that cannot be had is none: what is behind it shows the progress.
    this.#image.addEventListener("error", () => this.source(null));
    this.hide();
  }

  get isThere(): boolean {
    return !this.#image.hidden || !this.#still.hidden;
  }

  source(address: string | null): void {
    this.#image.hidden = address === null || address === "";
    if (address) this.#image.src = address;
    else this.#image.removeAttribute("src");
  }

  /** Keep what a canvas shows, which must have been drawn just now. */
  keep(canvas: HTMLCanvasElement): void {
    if (canvas.width === 0 || canvas.height === 0) return;
    Object.assign(this.#still, { width: canvas.width, height: canvas.height });
    this.#still.getContext("2d")?.drawImage(canvas, 0, 0);
    this.#still.hidden = false;
    this.#image.hidden = true;
  }

  /** Show the picture; with `asks`, a button that opens the viewer. */
  show(asks: boolean, label: string): void {
    this.#open.hidden = !asks;
    this.#open.ariaLabel = fillIn(texts.viewer.show3dOf, { name: label });
    this.element.hidden = !asks && !this.isThere;
    this.element.toggleAttribute("data-asks", asks);
  }

  hide(): void {
    this.element.hidden = true;
    this.#still.hidden = true;
    // A still picture holds memory.
    Object.assign(this.#still, { width: 0, height: 0 });
  }
}
