/** The interface around the picture: controls, messages, drag and drop, the divider of a comparison. */

import { Fault } from "../page/fault.js";
import { type Dropped, chooseFiles, droppedFiles, readDrop } from "./drop.js";
import { listening, make } from "./fields.js";
import { listenToOrbit, type OrbitHost } from "./orbit.js";
import { buildPanel } from "./panel.js";
import { download, exrOf, type FilmKind, filmOf, pngOf } from "./save.js";
import { lightText } from "./lightTexts.js";
import { initialState, toParameters, type ViewerState } from "./state.js";
import { viewerSheet } from "./styles.js";
import { statusText } from "../refine/status.js";
import type { Viewer } from "./viewer.js";

const messageMs = 8000;

/** The interface of one viewer, inside a shadow root. */
export class Interface {
  readonly #view = make("div", { className: "view" });
  readonly #message = make("div", { className: "message" });
  readonly #progress = make("progress", { max: 1, hidden: true, ariaLabel: "Reading the bundle" });
  readonly #welcome: HTMLElement;
  readonly #split: HTMLElement;
  readonly #handle = make("div", {
    ...{ className: "handle", tabIndex: 0, role: "slider", textContent: "⇔" },
    ...{ ariaLabel: "Divide the comparison", ariaValueMin: "0", ariaValueMax: "100" },
  });
  readonly #sides = make("div", { className: "sides", hidden: true });
  readonly #photo = make("img", { className: "photo", hidden: true, alt: "" });
  readonly #panel: { element: HTMLElement; show: () => void };
  readonly #stop = new AbortController();
  #photoShown = "";
  #quietAt = 0;

  constructor(
    root: ShadowRoot,
    private readonly host: HTMLElement,
    private readonly viewer: Viewer,
  ) {
    root.adoptedStyleSheets = [viewerSheet()];
    this.#message.role = "status";
    this.#message.ariaLive = "polite";
    this.#welcome = make(
      "div",
      { className: "welcome" },
      make("h1", { textContent: "Drop a relightable bundle here" }),
      make("p", {
        textContent: "A folder or a .relight.zip that Lambent has exported. Nothing leaves this computer.",
      }),
      this.#progress,
    );
    this.#split = make("div", { className: "split", hidden: true }, this.#handle);
    this.#panel = buildPanel(viewer, {
      change: (change) => this.#change(change),
      openBundle: () => this.#choose(".zip,.relight.zip", false),
      openFolder: () => this.#choose("", true),
      openMap: () => this.#choose(".hdr,.exr,.pic,.rgbe", false),
      openAddress: (address) => this.#change({ environment: `url:${address}` }),
      reset: () =>
        this.#change({ ...initialState, pose: viewer.home, environment: viewer.state.environment }),
      savePng: (...size) => this.#save("png", () => pngOf(viewer, ...this.#sizeOf(...size))),
      saveExr: (...size) => this.#save("exr", async () => exrOf(viewer, ...this.#sizeOf(...size))),
      film: (kind) => this.#film(kind),
      copyLink: () => void this.#copyLink(),
    });
    const { canvas } = viewer;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    this.#view.append(canvas, this.#photo, this.#split, this.#sides);
    root.replaceChildren(this.#view, this.#welcome, this.#message);
    if (host.hasAttribute("controls")) root.append(this.#panel.element);
    // On a telephone the picture comes first.
    this.#panel.element.toggleAttribute("open", host.clientWidth >= 640);
    this.#listen(canvas);
    this.describe();
    this.#show();
  }

  dispose(): void {
    this.#stop.abort();
    if (this.#photo.src) URL.revokeObjectURL(this.#photo.src);
  }

  /** Name the picture for those who do not see it. */
  describe(): void {
    const name = this.viewer.bundle?.name;
    const alt =
      this.host.getAttribute("alt") ?? (name ? `${name}, which can be relit` : "Relightable object");
    this.viewer.canvas.ariaLabel = `${alt}. Arrow keys turn the camera, square brackets the light.`;
  }

  /** Show the progress of reading a bundle during `work`; a failure is rethrown, and not shown. */
  async during(work: Promise<void>): Promise<void> {
    this.#progress.hidden = false;
    this.#progress.removeAttribute("value");
    try {
      await work;
    } finally {
      this.#progress.hidden = true;
    }
  }

  /** Show an error. */
  problem(error: unknown): void {
    if (error instanceof DOMException && error.name === "AbortError") return;
    let text = error instanceof Error ? error.message : String(error);
    if (error instanceof RangeError) text = `There is not enough memory for this (${text}).`;
    this.#tell(error instanceof Fault ? `${text} [${error.code}]` : text, true);
  }

  #tell(text: string, problem: boolean): void {
    this.#message.textContent = text;
    this.#message.toggleAttribute("data-problem", problem && text !== "");
    clearTimeout(this.#quietAt);
    if (!problem) this.#quietAt = setTimeout(() => this.#tell("", false), messageMs) as unknown as number;
  }

  #listen(canvas: HTMLCanvasElement): void {
    const { signal } = this.#stop;
    const on = listening(signal);
    const orbit: OrbitHost = {
      element: canvas,
      state: () => this.viewer.state,
      change: (next) => this.#change(next),
      elevation: () => this.viewer.elevationRange,
      moving: (moving) => {
        this.viewer.moving = moving;
      },
    };
    listenToOrbit(orbit, signal);
    const size = new ResizeObserver(() => {
      this.viewer.invalidate();
      this.#show();
    });
    size.observe(this.#view);
    signal.addEventListener("abort", () => size.disconnect());
    this.viewer.on("change", () => this.#show());
    this.viewer.on("message", (text, problem) => this.#tell(text, problem));
    this.viewer.on("refine", (status) => {
      const ended = status.phase === "done" || status.phase === "failed";
      if (ended) this.#tell(statusText(status), status.phase === "failed");
    });
    this.viewer.on("progress", (share) => {
      this.#progress.value = share;
    });
    this.viewer.on("load", () => {
      this.#welcome.hidden = true;
      this.#tell("", false);
      this.describe();
    });
    on(this.host, "dragover", (event) => this.#drag(event, true));
    on(this.host, "dragleave", (event) => this.#drag(event, false));
    on(this.host, "drop", (event) => {
      this.#drag(event, false);
      if (event.dataTransfer) void this.#take(readDrop(event.dataTransfer));
    });
    on(this.#handle, "pointermove", (event) => {
      if (!this.#handle.hasPointerCapture(event.pointerId)) return;
      const box = this.#view.getBoundingClientRect();
      this.#divide((event.clientX - box.left) / box.width);
    });
    on(this.#handle, "pointerdown", (event) => this.#handle.setPointerCapture(event.pointerId));
    on(this.#handle, "keydown", (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      this.#divide(this.viewer.state.split + step);
    });
  }

  #divide(split: number): void {
    this.#change({ split: Math.min(Math.max(split, 0), 1) });
  }

  #drag(event: DragEvent, over: boolean): void {
    event.preventDefault();
    this.#view.classList.toggle("dropping", over);
  }

  #change(change: Partial<ViewerState>): void {
    this.viewer.update(change).catch((error: unknown) => this.problem(error));
  }

  #choose(accept: string, folder: boolean): void {
    void this.#take(
      chooseFiles(accept, folder).then((files) => (files.length > 0 ? droppedFiles(files) : "nothing")),
    );
  }

  async #take(found: Promise<Dropped | null | "nothing">): Promise<void> {
    try {
      const dropped = await found;
      if (dropped === "nothing") return;
      if (dropped === null) {
        this.#tell("That is neither a .relight.zip, a bundle's folder, nor a .hdr or .exr map.", true);
      } else if (dropped.kind === "map") {
        const data = new Uint8Array(await dropped.file.arrayBuffer());
        await this.viewer.update({ environment: this.viewer.addMap(dropped.file.name, data) });
        this.#tell(`Lit by ${dropped.file.name}.`, false);
      } else {
        await this.during(this.viewer.open(dropped));
      }
    } catch (error) {
      this.problem(error);
    }
  }

  /** Return the size to save: a refined picture is saved as it is shown. */
  #sizeOf(width: number, height: number): readonly [number, number] {
    const shown = this.viewer.refinedCamera;
    if (shown === null) return [width, height];
    const size = `${shown.width} x ${shown.height}`;
    this.#tell(`The refined picture is saved in its own size, ${size} pixels.`, false);
    return [shown.width, shown.height];
  }

  #save(ending: "png" | "exr" | "webm", make: () => Promise<Blob>): void {
    make()
      .then((blob) => download(blob, `${this.viewer.bundle?.name ?? "lambent"}.${ending}`))
      .catch((error: unknown) => this.problem(error));
  }

  #film(kind: FilmKind): void {
    this.#tell("Recording…", false);
    this.#save("webm", () => filmOf(this.viewer, kind));
  }

  async #copyLink(): Promise<void> {
    const address = new URL(location.href);
    const parameters = toParameters(this.viewer.state);
    const source = new URLSearchParams(address.hash.slice(1)).get("src");
    if (source !== null) parameters.set("src", source);
    address.hash = parameters.toString();
    try {
      await navigator.clipboard.writeText(address.href);
      this.#tell("The link is on the clipboard.", false);
    } catch {
      this.#tell(address.href, false);
    }
  }

  /** Follow the viewer's state. */
  #show(): void {
    const { state } = this.viewer;
    this.#panel.show();
    this.host.setAttribute("data-background", state.look.background);
    const photo = this.#showPhoto();
    const comparing = state.compare === "photo" ? photo : state.compare !== "off";
    this.#split.hidden = !comparing;
    this.#split.style.left = `${100 * state.split}%`;
    this.#handle.ariaValueNow = `${Math.round(100 * state.split)}`;
    const right = {
      off: "",
      environment: lightText(this.viewer, state.environmentB),
      plain: "Plain image-based light",
      photo: "Photograph",
    };
    this.#sides.hidden = !comparing;
    const left = state.compare === "environment" ? lightText(this.viewer, state.environment) : "Relit";
    this.#sides.replaceChildren(
      ...[left, right[state.compare]].map((text) => make("span", { textContent: text })),
    );
  }

  /** Lay the photograph over the right side; returns whether there is one. */
  #showPhoto(): boolean {
    const { viewer } = this;
    const camera = viewer.photoCamera();
    const name = `photo_${viewer.state.photo}.png`;
    const picture = viewer.bundle?.previews.find((each) => each.name === name);
    this.#photo.hidden = camera === null || picture === undefined;
    if (camera === null || picture === undefined) return false;
    if (this.#photoShown !== `${viewer.bundle?.sceneId}/${name}`) {
      if (this.#photo.src) URL.revokeObjectURL(this.#photo.src);
      this.#photo.src = URL.createObjectURL(new Blob([picture.data], { type: "image/png" }));
      this.#photoShown = `${viewer.bundle?.sceneId}/${name}`;
    }
    const { clientWidth, clientHeight } = this.#view;
    const scale = Math.min(clientWidth / camera.width, clientHeight / camera.height);
    const [width, height] = [camera.width * scale, camera.height * scale];
    const left = 0.5 * (clientWidth - width);
    const hidden = Math.min(Math.max((viewer.state.split * clientWidth - left) / width, 0), 1);
    Object.assign(this.#photo.style, {
      left: `${left}px`,
      top: `${0.5 * (clientHeight - height)}px`,
      width: `${width}px`,
      height: `${height}px`,
      clipPath: `inset(0 0 0 ${100 * hidden}%)`,
    });
    return true;
  }
}
