/** Refined pictures of any size: parts that the workers take at once, refined one after the other, side by side. */

import { interrupted } from "../render/fault.js";
import type { ViewCamera } from "../render/looks.js";
import type { Side, Stage } from "../render/stage.js";
import { cameraOfPart, type Part, partsOf, shareIn } from "../render/tiles.js";
import { Refinement, type RefineView } from "./refinement.js";
import type { RefineStatus } from "./status.js";

/** What a refined picture is made of. */
export type StillHost = {
  readonly stage: Stage;
  /** Of the picture on the canvas; the camera is another one. */
  readonly view: RefineView;
  readonly sides: readonly Side[];
  /** Says that the picture can no longer be made. */
  readonly lost: AbortSignal;
};

/** A picture as bytes (sRGB-encoded, straight alpha) or half floats (linear, multiplied by alpha), four to a pixel. */
export type Pixels = Uint8ClampedArray<ArrayBuffer> | Uint16Array<ArrayBuffer>;

export type StillOptions = {
  readonly signal?: AbortSignal;
  /** Called as a part comes further. */
  readonly onProgress?: (part: number, parts: number, status: RefineStatus) => void;
};

/** The longest side of a part: with 2 x 2 points to a pixel no more points than are refined at full resolution. */
const partSide = 256;
/** Pixels around a part, so that the denoiser sees across its border. */
const margin = 16;

/** Return the parts of a picture. */
export function stillParts(width: number, height: number): Part[] {
  return partsOf(width, height, partSide - 2 * margin);
}

/** Return a part with what is around it, inside of the picture. */
export function widened({ left, top, width, height }: Part, whole: ViewCamera): Part {
  const [x, y] = [Math.max(left - margin, 0), Math.max(top - margin, 0)];
  const right = Math.min(left + width + margin, whole.width);
  const bottom = Math.min(top + height + margin, whole.height);
  return { left: x, top: y, width: right - x, height: bottom - y };
}

/**
 * Return what `camera` sees, refined until the viewer's own limits of noise and directions, read by `read` part by part.
 * Throws `refine.unavailable` and the like where it cannot be refined, and `refine.interrupted` where another bundle or
 * light was shown before the end, or the graphics card was lost.
 */
export async function refinedStill<T extends Pixels>(
  host: StillHost,
  camera: ViewCamera,
  into: T,
  read: (camera: ViewCamera, sides: readonly Side[]) => T,
  { signal, onProgress }: StillOptions = {},
): Promise<T> {
  const { stage, view, lost } = host;
  const ends = signal === undefined ? [lost] : [signal, lost];
  const held = () => [stage.bundle, stage.light("a"), stage.light("b")];
  const first = held();
  const parts = stillParts(camera.width, camera.height);
  let aim = camera;
  let hear: (status: RefineStatus) => void = () => {};
  const refinement = new Refinement({
    stage,
    view: () => ({
      ...view,
      ...{ camera: aim, moving: false },
    }),
    fades: false,
    redraw: () => {
      // It is of a part, and not of what is shown.
      stage.overlay = null;
    },
    tell: (status) => hear(status),
  });
  try {
    for (const [index, part] of parts.entries()) {
      const wide = widened(part, camera);
      aim = cameraOfPart(camera, wide);
      await new Promise<void>((resolve, reject) => {
        const stop = (): void => reject(ends.find(({ aborted }) => aborted)?.reason);
        for (const each of ends) each.addEventListener("abort", stop);
        const follow = (status: RefineStatus): void => {
          onProgress?.(index + 1, parts.length, status);
          for (const each of ends) each.throwIfAborted();
          if (held().some((each, place) => each !== first[place])) throw interrupted("refine");
          if (status.phase === "failed") throw new Error(status.message);
          if (status.phase !== "done") return;
          for (const each of ends) each.removeEventListener("abort", stop);
          const sides = host.sides.map((side) => ({
            ...side,
            ...{ from: shareIn(side.from, camera, wide), to: shareIn(side.to, camera, wide) },
          }));
          keep(
            read(
              aim,
              sides.filter(({ from, to }) => to > from),
            ),
            wide,
            part,
            into,
            camera.width,
          );
          // The event of a lost context comes later, and what was read is black.
          if (stage.renderer.getContext().isContextLost()) throw interrupted("refine");
          resolve();
        };
        hear = (status) => {
          try {
            follow(status);
          } catch (error) {
            reject(error);
          }
        };
        if (ends.some(({ aborted }) => aborted)) return stop();
        refinement.changed();
        refinement.rest(0);
      });
      hear = () => {};
    }
    return into;
  } finally {
    hear = () => {};
    refinement.dispose();
  }
}

/** Copy what is kept of a part. */
function keep<T extends Pixels>(from: T, wide: Part, part: Part, into: T, width: number): void {
  const [x, y] = [part.left - wide.left, part.top - wide.top];
  for (let row = 0; row < part.height; row++) {
    const start = 4 * ((y + row) * wide.width + x);
    into.set(from.subarray(start, start + 4 * part.width), 4 * ((part.top + row) * width + part.left));
  }
}
