/** What may be drawn in place of a baked picture. */

import type { Texture, WebGLRenderTarget } from "three";
import type { FullScreen } from "./fullScreen.js";
import type { Look, ViewCamera } from "./looks.js";

/** A baked picture, and the surface that it shows. */
export type Baked = {
  /** Radiance multiplied by coverage. */
  readonly radiance: Texture;
  /** As `surface.ts` packs samples, `samples` x `samples` to a pixel. */
  readonly seen: Texture;
  readonly facing: Texture;
  /** How much of every pixel is covered; null where its samples say so. */
  readonly mask: Texture | null;
  readonly samples: number;
  /** Whether it is what people see: a picture that is read shows where a change of it leads to. */
  readonly live: boolean;
};

/** A picture that may be drawn in place of the light "a" with baked transport. */
export type Overlay = {
  /** Whether it shows what a camera sees. */
  readonly shows: (camera: ViewCamera, look: Look) => boolean;
  /** Draw that into `target`, radiance multiplied by the coverage of the baked picture. */
  readonly draw: (
    screen: FullScreen,
    camera: ViewCamera,
    look: Look,
    baked: Baked,
    target: WebGLRenderTarget,
  ) => void;
};
