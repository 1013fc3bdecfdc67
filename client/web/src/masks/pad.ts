/** One photograph, large: marked, moved and zoomed with pointer, touch and keyboard. */

import { h } from "../page/dom.js";
import { boxOf, type Correction, type Point, strokeOf } from "./corrections.js";
import type { Frame } from "./backend.js";
import { drawCursor, drawMark, overlayOf } from "./paint.js";
import { afterKey, brushShare, type Tools } from "./tools.js";
import { fitted, moved, showing, toPhoto, toScreen, type Viewport, zoomed } from "./viewport.js";
import { fillIn, texts } from "../words/words.js";

export type PadHost = {
  readonly tools: () => Tools;
  readonly choose: (tools: Tools) => void;
  readonly mark: (correction: Correction) => void;
  /** The visitor pressed Escape while no mark was begun. */
  readonly leave: () => void;
  /** The next photograph (1) or the one before (-1). */
  readonly turn: (step: number) => void;
  readonly say: (text: string) => void;
};

const arrows: Readonly<Record<string, Point>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

export class Pad {
  readonly element = h("canvas", { tabindex: 0, role: "application" });
  #frame: Frame | null = null;
  #marks: readonly Correction[] = [];
  #picture: ImageBitmap | null = null;
  #overlay: HTMLCanvasElement | null = null;
  #view: Viewport = { scale: 1, x: 0, y: 0 };
  /** The mark that is being made: its points so far, in pixels of the photograph. */
  #points: Point[] | null = null;
  #cursor: Point | null = null;
  readonly #pointers = new Map<number, Point>();
  #marking: number | null = null;
  #frameAsked = 0;

  constructor(private readonly host: PadHost) {
    const canvas = this.element;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"] as const) {
      canvas.addEventListener(end, (event) => this.#up(event, end === "pointerup"));
    }
    canvas.addEventListener("pointerleave", () => {
      if (this.#points === null) this.#setCursor(null);
    });
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    new ResizeObserver(() => this.whole()).observe(canvas);
  }

  /** Show another photograph, whole; its picture and mask come later. */
  open(frame: Frame): void {
    this.clear();
    this.#frame = frame;
    this.element.style.aspectRatio = `${frame.width} / ${frame.height}`;
    this.element.setAttribute("aria-label", fillIn(texts.masks.canvas, { frame: frame.name }));
    this.whole();
  }

  /** Free the photograph. */
  clear(): void {
    this.#picture?.close();
    this.#picture = null;
    this.#overlay = null;
    this.#points = null;
    this.#cursor = null;
  }

  /** Show the open photograph's picture, which is closed here. */
  picture(picture: ImageBitmap): void {
    this.#picture?.close();
    this.#picture = picture;
    this.draw();
  }

  mask(mask: ImageBitmap): void {
    this.#overlay = overlayOf(mask);
    this.draw();
  }

  marks(marks: readonly Correction[]): void {
    this.#marks = marks;
    this.draw();
  }

  /** Show the whole photograph. */
  whole(): void {
    if (this.#frame !== null) this.#view = fitted(this.#frame, this.#screen);
    this.draw();
  }

  /** Zoom around the middle. */
  zoom(factor: number): void {
    const { width, height } = this.#screen;
    this.#zoom(factor, [width / 2, height / 2]);
  }

  /** Discard the mark that was begun; returns whether there was one. */
  cancel(): boolean {
    const begun = this.#points !== null;
    this.#points = null;
    this.#marking = null;
    this.draw();
    return begun;
  }

  /** Draw again with the next frame of the screen. */
  draw(): void {
    if (this.#frameAsked !== 0) return;
    this.#frameAsked = requestAnimationFrame(() => {
      this.#frameAsked = 0;
      this.#draw();
    });
  }

  get #screen() {
    return { width: Math.max(this.element.clientWidth, 1), height: Math.max(this.element.clientHeight, 1) };
  }

  get #radius(): number {
    const frame = this.#frame!;
    return brushShare(this.host.tools().brush) * Math.max(frame.width, frame.height);
  }

  #draw(): void {
    const { width, height } = this.#screen;
    const ratio = Math.min(devicePixelRatio, 2);
    const canvas = this.element;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d")!;
    const frame = this.#frame;
    if (frame === null) return;
    context.scale(ratio, ratio);
    const { scale, x, y } = this.#view;
    const place = [x, y, scale * frame.width, scale * frame.height] as const;
    context.fillStyle = "#303030";
    context.fillRect(...place);
    if (this.#picture !== null) context.drawImage(this.#picture, ...place);
    context.imageSmoothingEnabled = false;
    if (this.#overlay !== null) context.drawImage(this.#overlay, ...place);
    const begun = this.#begun();
    for (const mark of begun === null ? this.#marks : [...this.#marks, begun]) {
      drawMark(context, this.#view, mark);
    }
    const { shape, label } = this.host.tools();
    if (this.#cursor === null || shape === "move") return;
    const at = toScreen(this.#view, this.#cursor);
    drawCursor(context, at, shape === "brush" ? this.#radius * scale : null, label);
  }

  #begun(): Correction | null {
    const [frame, points] = [this.#frame, this.#points];
    if (frame === null || points === null) return null;
    const { shape, label } = this.host.tools();
    if (shape === "box") return boxOf(frame.name, label, points[0]!, points.at(-1)!, frame);
    return strokeOf(frame.name, label, points, this.#radius);
  }

  #finish(): void {
    const mark = this.#begun();
    this.cancel();
    if (mark !== null) this.host.mark(mark);
  }

  #at(event: MouseEvent): Point {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #down(event: PointerEvent): void {
    if (this.#frame === null) return;
    const at = this.#at(event);
    try {
      this.element.setPointerCapture(event.pointerId);
    } catch {
      // The pointer is up again already.
    }
    this.#pointers.set(event.pointerId, at);
    // A second finger zooms and moves; the first one did not mean to mark.
    if (this.#pointers.size > 1) {
      this.cancel();
      return;
    }
    if (event.button !== 0 || event.shiftKey || this.host.tools().shape === "move") return;
    this.#marking = event.pointerId;
    this.#points = [toPhoto(this.#view, ...at)];
    this.#setCursor(this.#points[0]!);
  }

  #move(event: PointerEvent): void {
    if (this.#frame === null) return;
    const before = this.#pointers.get(event.pointerId);
    const at = this.#at(event);
    if (this.#marking === event.pointerId) {
      const all = event.getCoalescedEvents?.() ?? [];
      const passed = all.length > 0 ? all.map((each) => this.#at(each)) : [at];
      this.#points?.push(...passed.map((each) => toPhoto(this.#view, ...each)));
    } else if (before !== undefined) {
      this.#drag(event.pointerId, before, at);
    }
    if (before !== undefined) this.#pointers.set(event.pointerId, at);
    this.#setCursor(toPhoto(this.#view, ...at));
  }

  #drag(id: number, before: Point, at: Point): void {
    const other = [...this.#pointers].find(([each]) => each !== id)?.[1];
    const [frame, screen] = [this.#frame!, this.#screen];
    if (other === undefined) {
      this.#view = moved(this.#view, at[0] - before[0], at[1] - before[1], frame, screen);
      return;
    }
    const gap = (point: Point) => Math.max(Math.hypot(point[0] - other[0], point[1] - other[1]), 1);
    const middle = [(at[0] + other[0]) / 2, (at[1] + other[1]) / 2] as const;
    const view = moved(this.#view, (at[0] - before[0]) / 2, (at[1] - before[1]) / 2, frame, screen);
    this.#view = zoomed(view, gap(at) / gap(before), ...middle, frame, screen);
  }

  #up(event: PointerEvent, completed: boolean): void {
    this.#pointers.delete(event.pointerId);
    if (this.#marking !== event.pointerId) return;
    this.#marking = null;
    if (completed) this.#finish();
    else this.cancel();
  }

  #wheel(event: WheelEvent): void {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 0 ? 1 : 30);
    this.#zoom(Math.exp(-0.0015 * pixels), this.#at(event));
  }

  #zoom(factor: number, [x, y]: Point): void {
    if (this.#frame === null) return;
    this.#view = zoomed(this.#view, factor, x, y, this.#frame, this.#screen);
    this.draw();
  }

  #setCursor(cursor: Point | null): void {
    this.#cursor = cursor;
    this.draw();
  }

  #key(event: KeyboardEvent): void {
    if (this.#frame === null || event.ctrlKey || event.metaKey || event.altKey) return;
    const actions: Readonly<Record<string, () => void>> = {
      "+": () => this.zoom(1.4),
      "-": () => this.zoom(1 / 1.4),
      "0": () => this.whole(),
      PageUp: () => this.host.turn(-1),
      PageDown: () => this.host.turn(1),
      Escape: () => {
        if (this.cancel()) this.host.say(texts.masks.given);
        else this.host.leave();
      },
      " ": () => this.#mark(),
      Enter: () => this.#mark(),
    };
    const arrow = arrows[event.key];
    const tools = afterKey(this.host.tools(), event.key);
    if (arrow !== undefined) this.#step(arrow, event.shiftKey ? 5 : 1);
    else if (tools !== null) this.host.choose(tools);
    else if (actions[event.key] !== undefined) actions[event.key]!();
    else return;
    event.preventDefault();
    this.draw();
  }

  /** Move the brush by keyboard, and the photograph where the brush would leave the screen. */
  #step([dx, dy]: Point, factor: number): void {
    const [frame, screen] = [this.#frame!, this.#screen];
    const step = (factor * 8) / this.#view.scale;
    const [x, y] = this.#cursor ?? this.#middle;
    const within = (value: number, most: number) => Math.min(Math.max(value, 0), most);
    const next: Point = [within(x + dx * step, frame.width), within(y + dy * step, frame.height)];
    this.#points?.push(next);
    this.#view = showing(this.#view, next, frame, screen);
    this.#setCursor(next);
  }

  /** Begin a mark by keyboard, or end it. */
  #mark(): void {
    if (this.host.tools().shape === "move") return;
    if (this.#points !== null) {
      this.#finish();
      return;
    }
    this.#setCursor(this.#cursor ?? this.#middle);
    this.#points = [this.#cursor!];
    this.host.say(texts.masks.begun);
  }

  get #middle(): Point {
    return toPhoto(this.#view, this.#screen.width / 2, this.#screen.height / 2);
  }
}
