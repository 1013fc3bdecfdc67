/** `<lambent-viewer>`: a bundle on any page. Documented in docs/reference/web-viewer.md. */

import type { BundleOrigin } from "../bundle/source.js";
import type { ViewCamera } from "../render/looks.js";
import type { FilmCallbacks } from "../film/film.js";
import type { FilmPlan } from "../film/plan.js";
import { Interface } from "./interface.js";
import { firstState, fromParameters, toParameters, type ViewerState } from "./state.js";
import { Viewer } from "./viewer.js";

/** The element. Attributes: `src`, `state`, `controls`, `alt`. */
export class LambentViewerElement extends HTMLElement {
  static readonly observedAttributes = ["src", "state", "alt"];
  #viewer: Viewer | null = null;
  #interface: Interface | null = null;
  #ready: Promise<void> = Promise.resolve();

  /** Resolves when the bundle of `src` is shown; rejects where it cannot be. */
  get ready(): Promise<void> {
    return this.#ready;
  }

  /** The renderer; null while the element is not in a document. */
  get viewer(): Viewer | null {
    return this.#viewer;
  }

  /** The state as one plain value. */
  get state(): ViewerState {
    return this.#open().state;
  }

  /** Change what is shown; resolves when a new light is there. */
  async update(change: Partial<ViewerState>): Promise<void> {
    await this.#open().update(change);
  }

  /** The state as parameters of an address. */
  get parameters(): string {
    return toParameters(this.state).toString();
  }

  /** Show a bundle: an address, a .relight.zip, or the files of a folder by their paths. */
  async show(source: string | Blob | ReadonlyMap<string, Blob>): Promise<void> {
    const viewer = this.#open();
    const shown = viewer.open(originOf(source));
    this.#ready = shown;
    const again = (): void => void this.#follow(this.show(source));
    await this.#interface!.during(shown, again);
  }

  /** Light the object with the bytes of an .hdr or .exr map. */
  async setEnvironmentFile(file: File): Promise<void> {
    const viewer = this.#open();
    const name = viewer.lights.addMap(file.name, new Uint8Array(await file.arrayBuffer()));
    await viewer.update({ environment: name });
  }

  /** Return the view, or that of `camera`, as straight RGBA bytes, rows from the top. */
  picture(size: { width: number; height: number } | ViewCamera, samples = 2): ImageData {
    const viewer = this.#open();
    const pixels =
      "cameraToWorld" in size
        ? viewer.pixelsOf(size, samples)
        : viewer.pixels(size.width, size.height, samples);
    return new ImageData(pixels, size.width, size.height);
  }

  /** Return a film of one turn of the camera, the light, or both, as MP4 or WebM; every frame of it is complete. */
  async film(options: Partial<FilmPlan> & FilmCallbacks = {}): Promise<Blob> {
    const viewer = this.#open();
    const { makeFilm } = await import("../film/film.js");
    return makeFilm(viewer, options, options);
  }

  connectedCallback(): void {
    if (this.#viewer !== null) return;
    const root = this.shadowRoot ?? this.attachShadow({ mode: "open" });
    const canvas = document.createElement("canvas");
    this.#viewer = new Viewer(canvas);
    this.#interface = new Interface(root, this, this.#viewer);
    const state = this.getAttribute("state");
    if (state !== null) this.#setState(state, true);
    const source = this.getAttribute("src");
    if (source) void this.#follow(this.show(source));
  }

  disconnectedCallback(): void {
    this.#interface?.dispose();
    this.#viewer?.dispose();
    this.#interface = null;
    this.#viewer = null;
    this.shadowRoot?.replaceChildren();
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if (this.#viewer === null || before === value) return;
    if (name === "src" && value) void this.#follow(this.show(value));
    if (name === "state" && value !== null) this.#setState(value);
    if (name === "alt") this.#interface?.describe();
  }

  #open(): Viewer {
    if (this.#viewer === null) throw new Error("<lambent-viewer> is in no document");
    return this.#viewer;
  }

  /** Show the state of an address; `fresh` where nothing was shown before it, so that its version says the rest. */
  #setState(text: string, fresh = false): void {
    const parameters = new URLSearchParams(text);
    void this.#follow(this.update(fromParameters(parameters, fresh ? firstState(parameters) : this.state)));
  }

  /** Show errors of calls whose result is not awaited. */
  async #follow(work: Promise<void>): Promise<void> {
    try {
      await work;
    } catch (error) {
      this.#interface?.problem(error);
    }
  }
}

function originOf(source: string | Blob | ReadonlyMap<string, Blob>): BundleOrigin {
  if (typeof source === "string") return { kind: "url", url: new URL(source, document.baseURI).href };
  return source instanceof Blob ? { kind: "archive", file: source } : { kind: "files", files: source };
}

/** Make the element known, once. */
export function defineViewer(): void {
  if (customElements.get("lambent-viewer") === undefined) {
    customElements.define("lambent-viewer", LambentViewerElement);
  }
}
