/** Buttons and keys that undo and redo. */

import { button, listening, make } from "./fields.js";
import { StateHistory } from "./history.js";
import type { ViewerState } from "./state.js";
import type { Viewer } from "./viewer.js";
import { texts } from "../words/words.js";

/** What undoes, at the edge of the picture. */
export type UndoTools = {
  readonly element: HTMLElement;
  /** Someone has taken hold of something, or lets go: what happens in between is undone at once. */
  readonly hold: (on: boolean) => void;
  /** What changes next is undone by itself, however soon it follows. */
  readonly apart: () => void;
  /** What was shown until now cannot be brought back. */
  readonly forget: () => void;
};

/** Follow a viewer's state until `signal`; keys are heard on `host`, and `change` shows another state. */
export function undoTools(
  viewer: Viewer,
  host: HTMLElement,
  change: (state: ViewerState) => void,
  signal: AbortSignal,
): UndoTools {
  const history = new StateHistory(viewer.state);
  const go = (state: ViewerState | null): void => {
    if (state !== null) change(state);
    show();
  };
  const undo = button("↶", () => go(history.undo()));
  const redo = button("↷", () => go(history.redo()));
  Object.assign(undo, { ariaLabel: texts.viewer.undo, title: texts.viewer.undoKey });
  Object.assign(redo, { ariaLabel: texts.viewer.redo, title: texts.viewer.redoKey });
  const element = make(
    "div",
    { className: "tools", role: "group", ariaLabel: texts.viewer.undoGroup },
    undo,
    redo,
  );

  function show(): void {
    for (const [each, can] of [
      [undo, history.canUndo],
      [redo, history.canRedo],
    ] as const) {
      // The button that someone has just used keeps the focus, and its place for those who listen.
      each.ariaDisabled = String(!can);
    }
  }
  function forget(): void {
    history.reset(viewer.state);
    show();
  }
  const stops = [
    viewer.on("change", () => {
      // The light of a bundle that is being read is found by it.
      if (viewer.bundle === null) return;
      history.record(viewer.state, performance.now());
      show();
    }),
    viewer.on("load", forget),
  ];
  signal.addEventListener("abort", () => {
    for (const stop of stops) stop();
  });
  listening(signal)(host, "keydown", (event) => {
    const step = stepOf(event);
    if (step === null || writesText(event)) return;
    event.preventDefault();
    go(step === "undo" ? history.undo() : history.redo());
  });
  show();
  return { element, hold: (on) => history.hold(on), apart: () => history.apart(), forget };
}

type Key = Pick<KeyboardEvent, "key" | "shiftKey" | "altKey" | "ctrlKey" | "metaKey">;

/** Return what a key asks for, or null. */
export function stepOf({ key, shiftKey, altKey, ctrlKey, metaKey }: Key): "undo" | "redo" | null {
  if (altKey || ctrlKey === metaKey) return null;
  const letter = key.toLowerCase();
  if (letter === "z") return shiftKey ? "redo" : "undo";
  return letter === "y" && ctrlKey && !shiftKey ? "redo" : null;
}

/** Return whether a key goes to a field that undoes what was typed into it. */
function writesText(event: Event): boolean {
  const [field] = event.composedPath();
  return field instanceof HTMLInputElement && ["text", "url", "number"].includes(field.type);
}
