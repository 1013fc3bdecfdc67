/** The interface around the picture: controls, messages, drag and drop, the divider of a comparison. */

import { Fault } from "../page/fault.js";
import { noInset } from "./camera.js";
import { CameraHands } from "./cameraControls.js";
import { ComparisonView } from "./comparison.js";
import { Controls } from "./controls.js";
import { copyLink } from "./copyLink.js";
import { type Dropped, type DroppedBundle, chooseFiles, droppedFiles, readDrop } from "./drop.js";
import { listening, make } from "./fields.js";
import { turnUntilInput } from "./firstTurn.js";
import { buildPanel } from "./panel.js";
import { download, exrOf, pngOf } from "./save.js";
import type { ViewerState } from "./state.js";
import { draggableSheet } from "./sheet.js";
import { viewerSheet } from "./styles.js";
import { refinedChannels, statusText } from "../refine/status.js";
import type { Viewer } from "./viewer.js";
import { Welcome } from "./welcome.js";
import { fillIn, locale, texts } from "../words/words.js";

const messageMs = 8000;
/** Share of the height that controls may take from the picture. */
const mostTaken = 0.65;

export type InterfaceActions = {
  /** Keep the viewer drawing during work that would be lost otherwise. */
  readonly during: <T>(work: () => Promise<T>) => Promise<T>;
  /** Show the files of a bundle; tells itself where they cannot be shown. */
  readonly open: (origin: DroppedBundle) => void;
};

/** The interface of one viewer, inside a shadow root. */
export class Interface {
  readonly #view = make("div", { className: "view" });
  readonly #message = make("div", { className: "message" });
  readonly #welcome = new Welcome();
  readonly #comparison: ComparisonView;
  readonly #panel: { element: HTMLDetailsElement; show: () => void };
  readonly #stop = new AbortController();
  readonly #dock = make("div", { className: "dock" });
  readonly #controls: Controls | null = null;
  #filming: import("../film/dialog.js").FilmDialog | null = null;
  #reading: Promise<void> | null = null;
  #quietAt = 0;

  constructor(
    root: ShadowRoot,
    private readonly host: HTMLElement,
    private readonly viewer: Viewer,
    private readonly act: InterfaceActions,
  ) {
    root.adoptedStyleSheets = [viewerSheet()];
    this.#message.role = "status";
    this.#message.ariaLive = "polite";
    this.#panel = buildPanel(viewer, {
      change: (change) => this.#change(change),
      openBundle: () => this.#choose(".zip,.relight.zip", false),
      openFolder: () => this.#choose("", true),
      reset: (part) => this.#controls?.reset(part),
      savePng: (...size) => this.#save(root, "png", size, () => pngOf(viewer, ...size)),
      saveExr: (...size) => this.#save(root, "exr", size, async () => exrOf(viewer, ...size)),
      film: () => void this.#film(root),
      copyLink: () => {
        const tell = (text: string, problem: boolean): void => this.#tell(text, problem);
        void copyLink({ viewer, root, tell, full: host.hasAttribute("fullpage") });
      },
    });
    const { canvas } = viewer;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    this.#view.append(canvas);
    this.#comparison = new ComparisonView(
      viewer,
      this.#view,
      (change) => this.#change(change),
      this.#stop.signal,
    );
    root.replaceChildren(this.#view, this.#welcome.element, this.#message);
    if (host.hasAttribute("controls")) {
      const act = {
        change: (change: Partial<ViewerState>) => this.#change(change),
        openMap: () => this.#choose(".hdr,.exr,.pic,.rgbe", false),
      };
      this.#controls = new Controls(viewer, host, act, this.#stop.signal);
      const { tools, strip } = this.#controls.elements;
      this.#view.append(tools);
      this.#dock.append(strip, this.#panel.element);
      root.append(this.#dock);
    }
    // The page around may be in another language.
    for (const part of root.children) if (part instanceof HTMLElement) part.lang = locale;
    // On a telephone the picture comes first.
    this.#panel.element.toggleAttribute("open", host.clientWidth >= 640);
    this.#listen(canvas);
    this.describe();
    this.#show();
  }

  dispose(): void {
    this.#stop.abort();
  }

  /** Name the picture for those who do not see it. */
  describe(): void {
    const name = this.viewer.bundle?.name;
    const alt =
      this.host.getAttribute("alt") ??
      (name ? fillIn(texts.viewer.relightable, { name }) : texts.viewer.object);
    this.viewer.canvas.ariaLabel = fillIn(texts.viewer.canvas, { object: alt });
  }

  /** Show the progress of reading a bundle; a failure is rethrown, and not shown. `again` asks for it anew. */
  async during(work: Promise<void>, again: (() => void) | null = null): Promise<void> {
    this.#reading = work;
    // A bundle that is shown stays until the next one is there.
    if (this.viewer.bundle === null) {
      this.#showPicture(false);
      this.#welcome.reading();
    }
    try {
      await work;
    } catch (error) {
      if (this.#reading === work) {
        // It may be one that came before, but gave way before it was lit.
        this.#showPicture(this.viewer.bundle !== null);
        if (this.viewer.bundle === null) this.#welcome.failed(again);
      }
      throw error;
    }
  }

  /** Show the picture with its controls, or the welcome text. */
  #showPicture(isThere: boolean): void {
    this.#welcome.element.hidden = isThere;
    this.#dock.hidden = !isThere;
    this.#controls?.show();
    if (!isThere) return;
    this.#makeRoom();
    this.describe();
  }

  problem(error: unknown): void {
    if (error instanceof DOMException && error.name === "AbortError") return;
    let text = error instanceof Error ? error.message : String(error);
    if (error instanceof RangeError) text = fillIn(texts.viewer.noMemory, { detail: text });
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
    const hands = {
      change: (next: Partial<ViewerState>) => this.#change(next),
      moving: (moving: boolean) => {
        if (this.#controls === null) this.viewer.moving = moving;
        else this.#controls.moving(moving);
      },
    };
    new CameraHands(this.viewer, hands, signal);
    // A page keeps its scrolling until someone uses the picture.
    const guard = (event: WheelEvent): void => {
      const isUsed = event.ctrlKey || this.host.shadowRoot?.activeElement === canvas;
      if (!isUsed && !this.host.hasAttribute("fullpage")) event.stopPropagation();
    };
    this.#view.addEventListener("wheel", guard, { signal, capture: true, passive: true });
    const size = new ResizeObserver((entries) => {
      if (entries.some(({ target }) => target === this.#view)) this.viewer.invalidate();
      this.#makeRoom();
      this.#show();
    });
    for (const each of [this.#view, this.#panel.element, this.#controls?.line]) if (each) size.observe(each);
    const isSheet = (): boolean => getComputedStyle(this.#dock).display === "flex";
    if (["fullpage", "light-turn"].some((name) => this.host.hasAttribute(name))) {
      const turning = (on: boolean): void => {
        if (this.#controls === null) this.viewer.moving = on;
        else this.#controls.turning(on);
      };
      turnUntilInput(this.viewer, this.host, turning, signal);
    }
    draggableSheet(this.#panel.element, isSheet, signal);
    signal.addEventListener("abort", () => size.disconnect());
    this.viewer.on("change", () => this.#show());
    this.viewer.on("message", (text, problem) => this.#tell(text, problem));
    this.viewer.on("refine", (status) => {
      const ended = status.phase === "done" || status.phase === "failed";
      if (ended) this.#tell(statusText(status), status.phase === "failed");
    });
    this.viewer.on("opened", (name) => this.#welcome.named(name));
    this.viewer.on("progress", (...bytes) => this.#welcome.arrived(...bytes));
    this.viewer.on("load", () => {
      this.#showPicture(true);
      this.#tell("", false);
    });
    on(this.host, "dragover", (event) => this.#drag(event, true));
    on(this.host, "dragleave", (event) => this.#drag(event, false));
    on(this.host, "drop", (event) => {
      this.#drag(event, false);
      if (event.dataTransfer) void this.#take(readDrop(event.dataTransfer));
    });
  }

  /** Keep the object in the middle of what the controls at the bottom leave free. */
  #makeRoom(): void {
    const box = this.#view.getBoundingClientRect();
    const line = this.#controls?.line.getBoundingClientRect();
    const taken = line === undefined || line.height === 0 ? 0 : box.bottom - line.top;
    const share = Math.max(taken / Math.max(box.height, 1), 0);
    // In a small element controls lie over the picture, of which hardly anything would be left beside them.
    this.viewer.inset = { ...noInset, bottom: share > mostTaken ? 0 : share };
  }

  #drag(event: DragEvent, over: boolean): void {
    event.preventDefault();
    this.#view.dataset.drop = texts.viewer.drop;
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
        this.#tell(texts.viewer.notUsable, true);
      } else if (dropped.kind === "map") {
        const data = new Uint8Array(await dropped.file.arrayBuffer());
        await this.viewer.update({ environment: this.viewer.lights.addMap(dropped.file.name, data) });
        this.#tell(fillIn(texts.viewer.litBy, { name: dropped.file.name }), false);
      } else {
        this.act.open(dropped);
      }
    } catch (error) {
      this.problem(error);
    }
  }

  /** Save a picture, refined if the one that is shown is. */
  #save(
    root: ShadowRoot,
    kind: "png" | "exr",
    [width, height]: readonly [number, number],
    make: () => Promise<Blob>,
  ): void {
    const { state, bundle } = this.viewer;
    const refined = async (): Promise<void> => {
      const { saveRefined } = await import("./stillDialog.js");
      await saveRefined(root, this.viewer, { width, height }, kind);
    };
    const plain = async (): Promise<void> => download(await make(), `${bundle?.name ?? "lambent"}.${kind}`);
    const isRefined = state.refine && refinedChannels.has(state.look.channel);
    this.act.during(isRefined ? refined : plain).catch((error: unknown) => this.problem(error));
  }

  async #film(root: ShadowRoot): Promise<void> {
    try {
      const [{ FilmDialog }, { dialogSheet }] = await Promise.all([
        import("../film/dialog.js"),
        import("./dialogs.js"),
      ]);
      if (this.#stop.signal.aborted || this.viewer.bundle === null) return;
      if (this.#filming === null) {
        this.#filming = new FilmDialog(this.viewer, this.act.during);
        root.adoptedStyleSheets.push(dialogSheet());
        root.append(this.#filming.element);
      }
      this.#filming.show();
    } catch (error) {
      this.problem(error);
    }
  }

  #show(): void {
    const { state } = this.viewer;
    this.#panel.show();
    this.#controls?.show();
    this.host.setAttribute("data-background", state.look.background);
    this.#comparison.show();
  }
}
