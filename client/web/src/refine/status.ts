/** The status and options of refining. */

import { fillIn, locale, texts } from "../words/words.js";

/**
 * What finds the light that reaches a point: "mesh": exact rays against the mesh, on the processor; "webgpu" and "wasm":
 * the graph of the fast cache, by onnxruntime on graphics hardware or on the processor.
 */
export type Backend = "mesh" | "webgpu" | "wasm";

/** The current status of a refinement. */
export type RefineStatus = {
  /** "waiting": something moves, or moved just now; the baked picture is shown. */
  readonly phase: "off" | "waiting" | "loading" | "running" | "done" | "failed";
  readonly backend: Backend | null;
  /** Why the backend is not a faster one, and unused adapted caches; empty if there is nothing to report. */
  readonly note: string;
  /** Light directions of a pixel so far. */
  readonly samplesPerPixel: number;
  /** Mean standard error of a pixel over mean radiance. */
  readonly relativeError: number;
  /** The error message. */
  readonly message: string;
};

/** Channels of which there is a refined picture; the others are not about light. */
export const refinedChannels: ReadonlySet<string> = new Set(["final", "direct", "indirect", "visibility"]);

export const notRefining: RefineStatus = {
  phase: "off",
  backend: null,
  note: "",
  samplesPerPixel: 0,
  relativeError: 0,
  message: "",
};

/** When refining stops, and its backend. */
export type RefineOptions = {
  /** "cache" is "webgpu" where that works, else "wasm". */
  readonly backend: Backend | "cache";
  /** Workers that trace the mesh; 0: as many as leave a processor to the page, four at most. */
  readonly workers: number;
  /** Points of the surface that are refined at most; 0: as many as the backend can in time. */
  readonly points: number;
  /** Smooth what noise is left in what is shown. */
  readonly denoise: boolean;
  /** Stop at this relative standard error, */
  readonly relativeError: number;
  /** or at so many light directions of a pixel. */
  readonly samplesPerPixel: number;
};

export const refineOptions: RefineOptions = {
  backend: "mesh",
  workers: 0,
  points: 0,
  denoise: true,
  relativeError: 0.02,
  samplesPerPixel: 512,
};

/** Return a status as a sentence. */
export function statusText(status: RefineStatus): string {
  const { phase, backend, note, samplesPerPixel, relativeError, message } = status;
  if (phase === "off") return "";
  if (phase === "waiting") return texts.refine.waiting;
  if (phase === "loading") return texts.refine.preparing;
  if (phase === "failed") return fillIn(texts.refine.failed, { why: message });
  const by =
    backend === null
      ? ""
      : fillIn(texts.refine.by, { place: `${texts.refine.places[backend]}${note && ` (${note})`}` });
  if (samplesPerPixel === 0) return fillIn(texts.refine.first, { by });
  const digits = { minimumSignificantDigits: 2, maximumSignificantDigits: 2 };
  const noise = new Intl.NumberFormat(locale, { style: "percent", ...digits }).format(relativeError);
  const progress = fillIn(texts.refine.progress, { samples: samplesPerPixel, noise, by });
  return phase === "done"
    ? fillIn(texts.refine.done, { progress })
    : fillIn(texts.refine.running, { progress });
}
