/** Makes films of a viewer frame by frame, each of them complete, however long that takes. */

import { Fault } from "../page/fault.js";
import type { Viewer } from "../viewer/viewer.js";
import { beginFilm } from "./encoder.js";
import { type FilmPlan, frameCount, momentAt, momentOf, planned } from "./plan.js";
import { fillIn, texts } from "../words/words.js";

/** How a film is made, besides what it shows. */
export type FilmCallbacks = {
  /** Ends the work: the film's promise then rejects with the signal's reason. */
  readonly signal?: AbortSignal;
  /** Called after every frame with how many there are, of how many, and what the last one looks like. */
  readonly onFrame?: (made: number, count: number, rgba: Uint8ClampedArray<ArrayBuffer>) => void;
};

/** Points to a pixel's side, as in pictures at rest. */
const samples = 2;

/**
 * Return a film of what a viewer shows now; what it shows meanwhile is not disturbed. Throws the faults `film.plan`,
 * `film.unsupported`, `film.interrupted` (another bundle or light was shown, or the graphics card was lost) and
 * `film.incomplete`.
 *
 * A comparison with a photograph is left out, because the camera of a photograph does not move. Films are opaque: a
 * transparent background becomes the background colour.
 */
export async function makeFilm(
  viewer: Viewer,
  asked: Partial<FilmPlan> = {},
  { signal, onFrame }: FilmCallbacks = {},
): Promise<Blob> {
  const plan = planned(asked);
  const { state } = viewer;
  const bare = state.look.background === "transparent";
  const look = bare ? { ...state.look, background: "colour" as const } : state.look;
  const compare = state.compare === "photo" ? "off" : state.compare;
  const draw = viewer.frozen({ ...state, look, compare });
  const count = frameCount(plan);
  signal?.throwIfAborted();
  const writer = await beginFilm(plan);
  try {
    for (let frame = 0; frame < count; frame++) {
      const change = momentOf(state, plan.motion, momentAt(plan, frame));
      const rgba = draw(change, plan.width, plan.height, samples);
      await writer.add(rgba);
      onFrame?.(frame + 1, count, rgba);
      await turnOfOthers();
      signal?.throwIfAborted();
    }
    return await writer.finish();
  } catch (error) {
    await writer.cancel();
    if (error instanceof DOMException && error !== signal?.reason) {
      throw new Fault("film.incomplete", fillIn(texts.film.encoderFailed, { detail: error.message }));
    }
    throw error;
  }
}

/** Let the page handle input; unlike timers this is not slowed down in a background tab. */
function turnOfOthers(): Promise<void> {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(null);
  });
}
