/** What was shown before, to undo and redo changes. */

import { flat, type ViewerState } from "./state.js";

/** Parts of the state that people change in many small steps; their names are those of an address. */
const continuous = new Set([
  "camera",
  "rotate",
  "intensity",
  "ev",
  "colour",
  "gain",
  "roughness",
  "metalness",
  "split",
]);
/** Small steps that follow each other faster than this are one change. */
const pauseMs = 1000;
const mostSteps = 200;

/** Return the names of the parts in which two states differ. */
export function changedParts(before: ViewerState, after: ViewerState): string[] {
  const [a, b] = [flat(before), flat(after)];
  return Object.keys(b).filter((name) => a[name] !== b[name]);
}

/** States in the order in which they were shown. */
export class StateHistory {
  #past: ViewerState[] = [];
  #future: ViewerState[] = [];
  #present: ViewerState;
  /** Parts that the last change is of; empty where the next one is a change of its own. */
  #parts = new Set<string>();
  #changedAt = 0;
  #held = false;

  constructor(state: ViewerState) {
    this.#present = state;
  }

  get canUndo(): boolean {
    return this.#past.length > 0;
  }

  get canRedo(): boolean {
    return this.#future.length > 0;
  }

  /** Forget everything: another object is shown. */
  reset(state: ViewerState): void {
    this.#past = [];
    this.#future = [];
    this.#parts.clear();
    this.#present = state;
  }

  /** Someone has taken hold of something, or lets go: what happens in between is one change. */
  hold(on: boolean): void {
    if (on && !this.#held) this.#parts.clear();
    this.#held = on;
  }

  /** What changes next is a change of its own. */
  apart(): void {
    this.#parts.clear();
  }

  /** Keep what is shown now. */
  record(state: ViewerState, nowMs: number): void {
    const parts = changedParts(this.#present, state);
    if (parts.length > 0) {
      const small = parts.every((name) => continuous.has(name));
      const goesOn = this.#held
        ? this.#parts.size > 0
        : nowMs - this.#changedAt < pauseMs && parts.every((name) => this.#parts.has(name));
      if (!small || !goesOn) {
        this.#past.push(this.#present);
        if (this.#past.length > mostSteps) this.#past.shift();
        this.#parts = new Set();
      }
      if (small) for (const name of parts) this.#parts.add(name);
      this.#future = [];
      this.#changedAt = nowMs;
    }
    this.#present = state;
  }

  /** Return what was shown before the last change, or null. */
  undo(): ViewerState | null {
    return this.#step(this.#past, this.#future);
  }

  /** Return what was shown before that was undone, or null. */
  redo(): ViewerState | null {
    return this.#step(this.#future, this.#past);
  }

  #step(from: ViewerState[], to: ViewerState[]): ViewerState | null {
    const state = from.pop();
    if (state === undefined) return null;
    to.push(this.#present);
    this.#present = state;
    this.#parts.clear();
    return state;
  }
}
