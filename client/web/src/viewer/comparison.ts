/** The divider of a comparison, the names of its sides, and the photograph on the right. */

import { listening, make } from "./fields.js";
import { lightText } from "./lightTexts.js";
import { edgeOf } from "./photograph.js";
import type { ViewerState } from "./state.js";
import type { Viewer } from "./viewer.js";
import { texts } from "../words/words.js";

/** The comparison of one viewer; its elements lie on the picture. */
export class ComparisonView {
  readonly #handle = make("div", {
    ...{ className: "handle", tabIndex: 0, role: "slider", textContent: "⇔" },
    ...{ ariaLabel: texts.compare.divide, ariaValueMin: "0", ariaValueMax: "100" },
  });
  readonly #split = make("div", { className: "split", hidden: true }, this.#handle);
  readonly #sides = make("div", { className: "sides", hidden: true });
  readonly #photo = make("img", { className: "photo", hidden: true, alt: "" });
  #photoShown = "";

  constructor(
    private readonly viewer: Viewer,
    private readonly view: HTMLElement,
    change: (change: Partial<ViewerState>) => void,
    signal: AbortSignal,
  ) {
    const on = listening(signal);
    const divide = (split: number): void => change({ split: Math.min(Math.max(split, 0), 1) });
    on(this.#handle, "pointermove", (event) => {
      if (!this.#handle.hasPointerCapture(event.pointerId)) return;
      const box = view.getBoundingClientRect();
      divide((event.clientX - box.left) / box.width);
    });
    on(this.#handle, "pointerdown", (event) => this.#handle.setPointerCapture(event.pointerId));
    on(this.#handle, "keydown", (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      divide(viewer.state.split + step);
    });
    on(this.#photo, "load", () => {
      viewer.photoEdge = edgeOf(this.#photo);
    });
    signal.addEventListener("abort", () => {
      if (this.#photo.src) URL.revokeObjectURL(this.#photo.src);
    });
    view.append(this.#photo, this.#split, this.#sides);
  }

  show(): void {
    const { state } = this.viewer;
    const photo = this.#showPhoto();
    const comparing = state.compare === "photo" ? photo : state.compare !== "off";
    this.#split.hidden = !comparing;
    this.#split.style.left = `${100 * state.split}%`;
    this.#handle.ariaValueNow = `${Math.round(100 * state.split)}`;
    this.#sides.hidden = !comparing;
    if (!comparing) return;
    const right = {
      off: "",
      environment: lightText(this.viewer, state.environmentB),
      plain: texts.compare.plain,
      photo: texts.compare.photograph,
    };
    const left =
      state.compare === "environment" ? lightText(this.viewer, state.environment) : texts.compare.relit;
    this.#sides.replaceChildren(
      ...[left, right[state.compare]].map((text) => make("span", { textContent: text })),
    );
  }

  /** Lay the photograph over the right side; returns whether there is one. */
  #showPhoto(): boolean {
    const { viewer } = this;
    const photo = viewer.photoCamera();
    const name = `photo_${viewer.state.photo}.png`;
    const picture = viewer.bundle?.previews.find((each) => each.name === name);
    this.#photo.hidden = photo === null || picture === undefined;
    if (photo === null || picture === undefined) return false;
    if (this.#photoShown !== `${viewer.bundle?.sceneId}/${name}`) {
      if (this.#photo.src) URL.revokeObjectURL(this.#photo.src);
      this.#photo.src = URL.createObjectURL(new Blob([picture.data], { type: "image/png" }));
      this.#photoShown = `${viewer.bundle?.sceneId}/${name}`;
    }
    // Where the camera of the canvas has the photograph.
    const { clientWidth, clientHeight } = this.view;
    const camera = viewer.canvasCamera({ width: clientWidth, height: clientHeight });
    const scale = camera.focalX / photo.focalX;
    const [width, height] = [photo.width * scale, photo.height * scale];
    const [left, top] = [camera.centreX - photo.centreX * scale, camera.centreY - photo.centreY * scale];
    const hidden = Math.min(Math.max((viewer.state.split * clientWidth - left) / width, 0), 1);
    Object.assign(this.#photo.style, {
      left: `${left}px`,
      top: `${top}px`,
      width: `${width}px`,
      height: `${height}px`,
      clipPath: `inset(0 0 0 ${100 * hidden}%)`,
    });
    return true;
  }
}
