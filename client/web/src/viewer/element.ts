/** `<lambent-viewer>`: a bundle on any page. Documented in docs/reference/web-viewer.md. */

import type { BundleOrigin } from "../bundle/source.js";
import type { FilmCallbacks } from "../film/film.js";
import type { FilmPlan } from "../film/plan.js";
import { Fault } from "../page/fault.js";
import type { StillOptions } from "../refine/still.js";
import type { ViewCamera } from "../render/looks.js";
import { isInWindow } from "./firstTurn.js";
import { Interface } from "./interface.js";
import { Poster } from "./poster.js";
import { type Guest, seats } from "./seats.js";
import { fromParameters, initialState, toParameters, type ViewerState } from "./state.js";
import { viewerSheet } from "./styles.js";
import { Viewer } from "./viewer.js";
import { texts } from "../words/words.js";

type Source = string | Blob | ReadonlyMap<string, Blob>;

/** How far outside of the window a lazy element begins to load. */
const nearMargin = "25%";

/** The element. Attributes: `src`, `state`, `controls`, `alt`, `poster`, `loading`, `reveal`, `light-turn`, `fullpage`. */
export class LambentViewerElement extends HTMLElement {
  static readonly observedAttributes = ["src", "state", "alt", "poster"];
  #viewer: Viewer | null = null;
  #interface: Interface | null = null;
  #ready: Promise<void> = Promise.resolve();
  /** Takes the promise of what is shown, where it was promised before anything was opened. */
  #promised: ((shown: Promise<void>) => void) | null = null;
  /** Kept while nothing is drawn. */
  #state: ViewerState = initialState;
  #source: Source | null = null;
  /** Whether it may load: it is near the window, or need not be, and someone asked for it, or need not. */
  #wanted = false;
  /** Films and pictures that are being made. */
  #works = 0;
  #near: IntersectionObserver | null = null;
  readonly #poster = new Poster(() => this.reveal());
  readonly #guest: Guest = {
    wake: () => this.#wake(),
    rest: () => this.#rest(),
    isBusy: () => this.#works > 0 || (this.#viewer?.lights.mapNames.length ?? 0) > 0,
  };

  /** Resolves when the bundle of `src` is shown; rejects where it cannot be. */
  get ready(): Promise<void> {
    return this.#ready;
  }

  /** The renderer; null while the element draws nothing. */
  get viewer(): Viewer | null {
    return this.#viewer;
  }

  /** The state as one plain value. */
  get state(): ViewerState {
    return this.#viewer?.state ?? this.#state;
  }

  /** Change what is shown; resolves when a new light is there. */
  async update(change: Partial<ViewerState>): Promise<void> {
    if (this.#viewer !== null) await this.#viewer.update(change);
    else this.#state = { ...this.#state, ...change };
  }

  /** The state as parameters of an address. */
  get parameters(): string {
    return toParameters(this.state).toString();
  }

  /** Draw, where only the poster was shown. */
  reveal(): void {
    this.#want(true);
    seats.use(this.#guest);
  }

  /** Show a bundle: an address, a .relight.zip, or the files of a folder by their paths. */
  async show(source: Source): Promise<void> {
    if (this.#near === null) throw new Error("<lambent-viewer> is in no document");
    this.#source = source;
    if (this.#viewer !== null) this.#show(source);
    // This shows it, too.
    else this.reveal();
    if (this.#viewer === null) throw new Error(texts.viewer.busy);
    await this.#ready;
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

  /** Return the view, or that of a camera, refined, in any size; see `picture`. Takes seconds to minutes. */
  async refinedPicture(
    size: { readonly width: number; readonly height: number } | ViewCamera,
    options: StillOptions = {},
  ): Promise<ImageData> {
    const viewer = this.#open();
    const { refinedPixels } = await import("./stillFile.js");
    return this.#busy(
      async () => new ImageData(await refinedPixels(viewer, size, options), size.width, size.height),
    );
  }

  /** Return a film of one turn of the camera, the light, or both, as MP4 or WebM; every frame of it is complete. */
  async film(options: Partial<FilmPlan> & FilmCallbacks = {}): Promise<Blob> {
    const viewer = this.#open();
    const { makeFilm } = await import("../film/film.js");
    return this.#busy(() => makeFilm(viewer, options, options));
  }

  connectedCallback(): void {
    if (this.#near !== null) return;
    const root = this.shadowRoot ?? this.attachShadow({ mode: "open" });
    root.adoptedStyleSheets = [viewerSheet()];
    this.#poster.source(this.getAttribute("poster"));
    root.append(this.#poster.element);
    this.#source = this.getAttribute("src") || this.#source;
    const state = this.getAttribute("state");
    // What was shown before the element was taken out stays where the attribute says nothing.
    if (state !== null) this.#state = fromParameters(new URLSearchParams(state), this.#state);
    if (this.#source !== null) {
      this.#ready = new Promise((resolve) => {
        this.#promised = resolve;
      });
      this.#ready.catch(() => {}); // Nobody may be waiting; the message tells of it.
    }
    const [lazy, manual] = [
      this.getAttribute("loading") === "lazy",
      this.getAttribute("reveal") === "manual",
    ];
    this.#near = new IntersectionObserver(
      (entries) => {
        const near = entries.at(-1)!.isIntersecting;
        if (near && !manual) this.#want(true);
        seats.look(this.#guest, near);
      },
      { rootMargin: nearMargin },
    );
    this.#near.observe(this);
    if (lazy || manual) this.#poster.show(manual, this.#label);
    else this.#want(isInWindow(this));
  }

  disconnectedCallback(): void {
    this.#near?.disconnect();
    this.#near = null;
    this.#wanted = false;
    if (this.#viewer !== null) this.#keepState(this.#viewer);
    this.#close();
    seats.leave(this.#guest);
    this.shadowRoot?.replaceChildren();
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if (this.#near === null || before === value) return;
    if (name === "poster") this.#poster.source(value);
    if (name === "alt") this.#interface?.describe();
    if (name === "state" && value !== null) {
      const next = fromParameters(new URLSearchParams(value), this.state);
      void this.#follow(this.update(next));
    }
    if (name !== "src" || !value) return;
    this.#source = value;
    if (this.#viewer !== null) this.#show(value);
  }

  get #label(): string {
    return this.getAttribute("alt") ?? texts.viewer.object;
  }

  /** Draw from now on, if there is a seat. */
  #want(visible: boolean): void {
    if (this.#wanted || this.#near === null) return;
    this.#wanted = true;
    seats.join(this.#guest, visible);
    // All seats are taken by others that are seen.
    if (this.#viewer === null) this.#poster.show(true, this.#label);
  }

  #wake(): void {
    const root = this.shadowRoot!;
    const viewer = new Viewer(document.createElement("canvas"));
    this.#viewer = viewer;
    this.#interface = new Interface(root, this, viewer, {
      during: (work) => this.#busy(work),
      open: (dropped) => this.#show(sourceOf(dropped)),
    });
    // The progress is above it.
    root.querySelector(".welcome")!.before(this.#poster.element);
    this.#poster.show(false, this.#label);
    this.#tellOf(viewer);
    void this.#follow(viewer.update(this.#state));
    if (this.#source !== null) this.#show(this.#source);
    else this.#poster.hide();
  }

  /** Give the graphics context back; the last picture stays. */
  #rest(): void {
    const viewer = this.#viewer!;
    this.#keepState(viewer);
    if (viewer.bundle !== null) {
      viewer.drawNow(2);
      this.#poster.keep(viewer.canvas);
    }
    this.#close();
    this.shadowRoot?.replaceChildren(this.#poster.element);
    this.#poster.show(true, this.#label);
  }

  /** Keep what is shown for another viewer, which turns a light that nobody has turned by itself. */
  #keepState({ state, homeTurn }: Viewer): void {
    this.#state = state.turn === homeTurn ? { ...state, turn: initialState.turn } : state;
  }

  #close(): void {
    this.#interface?.dispose();
    this.#viewer?.dispose();
    this.#interface = null;
    this.#viewer = null;
  }

  #show(source: Source): void {
    const viewer = this.#viewer!;
    this.#source = source;
    const shown = viewer.open(originOf(source));
    // What cannot be shown is not opened again in place of what is.
    shown.catch(() => {
      const { source: kept } = viewer;
      if (this.#source === source && this.#viewer === viewer && kept !== null) this.#source = sourceOf(kept);
    });
    if (this.#promised === null) this.#ready = shown;
    this.#promised?.(shown);
    this.#promised = null;
    void this.#follow(
      this.#interface!.during(shown, () => this.#show(source)),
      true,
    );
  }

  /** Pass what happens on as events of the element. */
  #tellOf(viewer: Viewer): void {
    let { pose, turn, environment } = this.#state;
    viewer.on("progress", (readBytes, totalBytes) => this.#tell("progress", { readBytes, totalBytes }));
    viewer.on("load", ({ name }) => this.#tell("load", { name }));
    viewer.on("draw", () => {
      if (!this.#poster.element.hidden) this.#poster.hide();
    });
    viewer.on("change", () => {
      const now = viewer.state;
      if (now.pose !== pose) this.#tell("camera-change", { pose: now.pose });
      if (now.turn !== turn || now.environment !== environment) {
        this.#tell("light-change", { environment: now.environment, turn: now.turn });
      }
      ({ pose, turn, environment } = now);
    });
  }

  #tell(name: string, detail: unknown): void {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  async #busy<T>(work: () => Promise<T>): Promise<T> {
    this.#works++;
    try {
      return await work();
    } finally {
      this.#works--;
    }
  }

  #open(): Viewer {
    if (this.#viewer === null && this.isConnected) {
      throw new Error("<lambent-viewer> shows its poster; call reveal(), and wait for `ready`");
    }
    if (this.#viewer === null) throw new Error("<lambent-viewer> is in no document");
    return this.#viewer;
  }

  /** Show errors of calls whose result is not awaited; with `opening`, the poster cannot stay. */
  async #follow(work: Promise<void>, opening = false): Promise<void> {
    try {
      await work;
    } catch (error) {
      if (error instanceof DOMException && error.name === "AbortError") return;
      if (opening) this.#poster.hide();
      this.#interface?.problem(error);
      const message = error instanceof Error ? error.message : String(error);
      this.#tell("error", { code: error instanceof Fault ? error.code : "viewer.failed", message });
    }
  }
}

function originOf(source: Source): BundleOrigin {
  if (typeof source === "string") return { kind: "url", url: new URL(source, document.baseURI).href };
  return source instanceof Blob ? { kind: "archive", file: source } : { kind: "files", files: source };
}

/** Return an origin as `show` takes it. */
function sourceOf(origin: BundleOrigin): Source {
  if (origin.kind === "url") return origin.url;
  return origin.kind === "archive" ? origin.file : origin.files;
}

/** Make the element known, once. */
export function defineViewer(): void {
  if (customElements.get("lambent-viewer") === undefined) {
    customElements.define("lambent-viewer", LambentViewerElement);
  }
}
