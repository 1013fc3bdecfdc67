/** The interface between the editor of masks and what computes them: `lambent masks --edit`, or a server. */

import type { CorrectionList, Size } from "./corrections.js";

export type Frame = Size & {
  readonly name: string;
  /** The mask disagrees with those of the other photographs. */
  readonly doubtful: boolean;
};

export type Capture = {
  readonly frames: readonly Frame[];
  /** Those of earlier sessions. */
  readonly corrections: CorrectionList;
  /** How well the views agree, 0..1. */
  readonly agreement: number;
  /** Why nothing was found; empty where something was. */
  readonly reason: string;
};

export type Applied = {
  readonly agreement: number;
  /** Names of the frames whose masks disagree with the others. */
  readonly doubtful: readonly string[];
  /** Names of the frames whose mask has changed. */
  readonly changed: readonly string[];
};

export interface MaskBackend {
  load(): Promise<Capture>;
  /** Return a photograph whose longer side has about `side` pixels, as JPEG. */
  picture(frame: string, side: number): Promise<Blob>;
  /** Return the mask of a frame as it is now: a small grey PNG, white where the object is. */
  mask(frame: string): Promise<Blob>;
  /** Apply all corrections to all photographs; a later call may end this one. */
  apply(corrections: CorrectionList, signal: AbortSignal): Promise<Applied>;
  /** Keep the masks, and return how to continue: a command for a terminal, or the address of a page. */
  finish(corrections: CorrectionList): Promise<string>;
}
