/** Messages between page and worker. */

import type { AtlasMesh } from "../bundle/mesh.js";
import type { BundleOrigin } from "../bundle/source.js";
import type { HitTransport, PackedTransport } from "../bundle/transport.js";
import type { PreparedLight } from "../light/prepare.js";
import type { RefinedPicture } from "./accumulation.js";
import type { PixelFeatures } from "./denoise.js";
import type { FallingLight } from "../engine/fallingLight.js";
import type { PassMeans } from "./passes.js";
import type { Backend, RefineOptions } from "./status.js";
import type { RefineEdit, SurfaceSamples } from "./surfacePoints.js";

/** Open the networks of a bundle whose baked parts are known already. */
export type OpenQuestion = {
  readonly ask: "open";
  readonly origin: BundleOrigin;
  readonly sceneId: string;
  readonly mesh: AtlasMesh;
  readonly transport: PackedTransport;
  readonly backend: RefineOptions["backend"];
  readonly share: WorkerShare;
};

/** The passes of one worker among several: `index`, `index + count`, ... The first one adds all of them up. */
export type WorkerShare = {
  readonly index: number;
  readonly count: number;
  /** To the first worker; its own: to all others. */
  readonly ports: readonly MessagePort[];
};

/** What the first worker has read for the others. */
export type SharedTables = Pick<HitTransport, "material" | "shadowBits">;

/** Passes that a worker sends to the first one. */
export type SharedPass = { readonly id: number; readonly means: PassMeans };

/** Refine a picture, and forget the one before. */
export type StartQuestion = {
  readonly ask: "start";
  readonly id: number;
  /** Null where it is the same as before. */
  readonly levels: PreparedLight["levels"] | null;
  /** From the light's map to the world, rows of a rotation. */
  readonly turn: readonly number[];
  readonly intensity: number;
  readonly falling: FallingLight;
  readonly edit: RefineEdit;
  readonly indirect: boolean;
  readonly seen: SurfaceSamples;
  readonly options: RefineOptions;
};

/** Stop refining; `id` is that of the only picture that is meant, where not any. */
export type StopQuestion = { readonly ask: "stop"; readonly id?: number };

export type RefineQuestion = OpenQuestion | StartQuestion | StopQuestion;

export type RefineAnswer =
  | { readonly kind: "opened"; readonly backend: Backend; readonly note: string; readonly slow: boolean }
  | {
      readonly kind: "picture";
      readonly id: number;
      readonly picture: RefinedPicture;
      /** The same, smoothed; null where that is not wanted. */
      readonly shown: RefinedPicture | null;
      /** Of the first picture; null later on, for they do not change. */
      readonly features: PixelFeatures | null;
      readonly done: boolean;
    }
  | { readonly kind: "failed"; readonly code: string; readonly message: string };
