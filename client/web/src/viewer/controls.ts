/** The controls on the picture: undo, lights, and the direction of the light. */

import { lightBall } from "./lightBall.js";
import { lightStrip, type StripActions } from "./lightStrip.js";
import { resetOf, type ResetPart } from "./resets.js";
import type { ViewerState } from "./state.js";
import { undoTools } from "./undo.js";
import type { Viewer } from "./viewer.js";

export type ControlActions = Pick<StripActions, "openMap"> & {
  readonly change: (change: Partial<ViewerState>) => void;
};

/** The controls of one viewer, inside its element `host`. */
export class Controls {
  readonly #undo;
  readonly #strip;
  readonly #ball;

  constructor(
    private readonly viewer: Viewer,
    host: HTMLElement,
    private readonly act: ControlActions,
    signal: AbortSignal,
  ) {
    const choose = (environment: string): void => act.change({ environment });
    const turn = { turn: (next: ViewerState["turn"]) => act.change({ turn: next }) };
    this.#undo = undoTools(viewer, host, act.change, signal);
    this.#strip = lightStrip(
      viewer,
      { choose, openMap: act.openMap, openAddress: (address) => choose(`url:${address}`) },
      signal,
    );
    this.#ball = lightBall(viewer, { ...turn, moving: (on) => this.moving(on) }, signal);
    this.#strip.row.append(this.#ball.element);
  }

  /** What undoes, for the top of the picture, and the lights, for its bottom. */
  get elements(): { tools: HTMLElement; strip: HTMLElement } {
    return { tools: this.#undo.element, strip: this.#strip.element };
  }

  /** The row at the bottom. */
  get line(): HTMLElement {
    return this.#strip.row;
  }

  /** Someone has taken hold of something, or lets go. */
  moving(on: boolean): void {
    this.viewer.moving = on;
    this.#undo.hold(on);
  }

  /** The light turns by itself, or has stopped: nobody undoes what nobody did. */
  turning(on: boolean): void {
    this.viewer.moving = on;
    if (!on) this.#undo.forget();
  }

  reset(part: ResetPart): void {
    this.#undo.apart();
    this.act.change(resetOf(part, this.viewer.state, this.viewer));
  }

  show(): void {
    const isThere = this.viewer.bundle !== null;
    for (const each of [this.#undo.element, this.#strip.element]) each.hidden = !isThere;
    this.#strip.show();
    this.#ball.show();
  }
}
