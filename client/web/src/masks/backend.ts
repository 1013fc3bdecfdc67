/** What the editor of masks asks of whoever computes them: the command `lambent masks --edit`, or a server. */

import type { CorrectionList, Size } from "./corrections.js";

export type Frame = Size & {
  readonly name: string;
  /** The other photographs see it differently. */
  readonly doubtful: boolean;
};

export type Capture = {
  readonly frames: readonly Frame[];
  /** Of an earlier sitting. */
  readonly corrections: CorrectionList;
  /** Of the views, 0..1. */
  readonly agreement: number;
  /** Why nothing was found; empty where something was. */
  readonly reason: string;
};

export type Applied = {
  readonly agreement: number;
  /** Names of the frames that the others see differently. */
  readonly doubtful: readonly string[];
  /** Names of the frames whose mask is another now. */
  readonly changed: readonly string[];
};

export type Finished = {
  /** What happens next, in words. */
  readonly told: string;
  /** To be typed in a terminal. */
  readonly command?: string;
  /** Where to go on. */
  readonly address?: string;
};

export interface MaskBackend {
  load(): Promise<Capture>;
  /** Return a photograph whose longer side has about `side` pixels, as JPEG. */
  picture(frame: string, side: number): Promise<Blob>;
  /** Return the mask of a frame as it is now: a small grey PNG, white where the object is. */
  mask(frame: string): Promise<Blob>;
  /** Carry all corrections to all photographs. Corrections that are asked for later may end this one. */
  apply(corrections: CorrectionList, signal: AbortSignal): Promise<Applied>;
  finish(corrections: CorrectionList): Promise<Finished>;
}
