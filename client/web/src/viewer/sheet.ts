/** The panel of controls as a sheet at the bottom of a narrow page, which opens and closes with a finger. */

import { listening, releases } from "./fields.js";

/** Movements below this are a tap. */
const tapPixels = 8;
/** A faster movement opens or closes, however short it is; in pixels per millisecond. */
const flickSpeed = 0.5;

/** Let people drag a panel by its summary, until `signal`, where `isSheet` says that it is a sheet. */
export function draggableSheet(panel: HTMLDetailsElement, isSheet: () => boolean, signal: AbortSignal): void {
  const on = listening(signal);
  const summary = panel.querySelector("summary")!;
  let held: { id: number; y: number; height: number; lastY: number; lastAt: number; speed: number } | null =
    null;
  let dragged = false;

  on(summary, "pointerdown", (event) => {
    dragged = false;
    if (event.button !== 0 || !isSheet()) return;
    const height = panel.offsetHeight;
    held = {
      ...{ id: event.pointerId, y: event.clientY, height },
      ...{ lastY: event.clientY, lastAt: event.timeStamp, speed: 0 },
    };
  });
  on(summary, "pointermove", (event) => {
    if (held?.id !== event.pointerId) return;
    const up = held.y - event.clientY;
    if (!dragged && Math.abs(up) < tapPixels) return;
    if (!dragged) {
      dragged = true;
      summary.setPointerCapture(event.pointerId);
      panel.open = true;
    }
    const passed = Math.max(event.timeStamp - held.lastAt, 1);
    Object.assign(held, {
      speed: (held.lastY - event.clientY) / passed,
      lastY: event.clientY,
      lastAt: event.timeStamp,
    });
    panel.style.height = `${Math.max(held.height + up, summary.offsetHeight)}px`;
  });
  const lift = (event: PointerEvent): void => {
    if (held?.id !== event.pointerId) return;
    const { speed } = held;
    held = null;
    if (!dragged) return;
    const isHigh = panel.offsetHeight > 0.5 * largestOf(panel);
    panel.style.height = "";
    panel.open = Math.abs(speed) > flickSpeed ? speed > 0 : isHigh;
  };
  for (const lifted of releases) on(summary, lifted, lift);
  // A drag ends with a click, which must not toggle the panel.
  on(summary, "click", (event) => {
    if (dragged) event.preventDefault();
    dragged = false;
  });
}

/** Return the height of the open panel. */
function largestOf(panel: HTMLElement): number {
  const most = Number.parseFloat(getComputedStyle(panel).maxHeight);
  return Number.isFinite(most) ? Math.min(most, panel.scrollHeight) : panel.scrollHeight;
}
