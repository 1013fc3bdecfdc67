/** Uploads a scene: hashes it, asks which files the server lacks, sends them, and commits the upload. */

import {
  type Api,
  inLines,
  pause,
  type PlannedFile,
  Refused,
  type Scene,
  Unreachable,
} from "../page/rest.js";
import type { Candidate, SceneFile } from "./collect.js";
import { type DirectTools, directSender } from "./direct.js";

/** Returns the SHA-256 of a file's bytes, lower-case hexadecimal; rejects where they cannot be read. */
export type Hash = (blob: Blob) => Promise<string>;

export type UploadStep = {
  readonly what: "hash" | "send" | "wait" | "commit";
  readonly doneBytes: number;
  readonly totalBytes: number;
  /** Files that the server had already. */
  readonly numKnown: number;
};

export type UploadTools = {
  readonly api: Pick<Api, "createScene" | "planFiles" | "putFile" | "putArchive" | "commit" | "scene"> &
    DirectTools["api"];
  readonly hash: Hash;
  readonly onStep: (step: UploadStep) => void;
  readonly signal: AbortSignal;
  /** Wait so many milliseconds, less when `signal` is aborted. */
  readonly wait?: (milliseconds: number, signal: AbortSignal) => Promise<void>;
};

const parallel = 3;
const longestPauseMs = 15_000;

/**
 * Send a candidate as a new scene, or continue the upload of the scene `sceneId`; return the scene.
 *
 * Waits for a server that does not answer. Files that it has are not sent again, so an interrupted upload is
 * continued by repeating it. Throws Refused where the server declines, and the signal's reason when it is aborted.
 */
export async function upload(
  candidate: Candidate,
  tools: UploadTools,
  sceneId: string | null = null,
): Promise<Scene> {
  const patient = patience(tools);
  const id = sceneId ?? (await patient(() => tools.api.createScene(candidate.name))).id;
  if (candidate.kind === "archive") {
    const { file, mediaType } = candidate;
    tools.onStep({ what: "send", doneBytes: 0, totalBytes: file.size, numKnown: 0 });
    return patient(() => sendArchive(tools, id, file, mediaType));
  }
  const hashed = await hashAll(candidate.files, tools);
  const plan = await patient(() => tools.api.planFiles(id, hashed.planned));
  const missing = new Set(plan.missing);
  const direct = directSender(id, plan.uploads, tools);
  const unique = [...hashed.bySha256].filter(([sha256]) => missing.has(sha256));
  const numKnown = hashed.bySha256.size - unique.length;
  const totalBytes = unique.reduce((sum, [, file]) => sum + file.sizeBytes, 0);
  let doneBytes = 0;
  const tell = (what: "send" | "wait" | "commit") => tools.onStep({ what, doneBytes, totalBytes, numKnown });
  const send = async ([sha256, file]: [string, SceneFile]) => {
    tools.signal.throwIfAborted();
    const body = await file.read();
    await patience(tools, () => tell("wait"))(async () => {
      if (!(await direct(sha256, body))) await tools.api.putFile(id, sha256, body, tools.signal);
    });
    doneBytes += file.sizeBytes;
    tell("send");
  };
  tell("send");
  await inLines(parallel, unique, send);
  tell("commit");
  return patient(() => tools.api.commit(id));
}

async function sendArchive(tools: UploadTools, id: string, file: File, mediaType: string): Promise<Scene> {
  try {
    return await tools.api.putArchive(id, file, mediaType, tools.signal);
  } catch (error) {
    // The first try got through and only its answer was lost.
    if (error instanceof Refused && error.code === "scene_committed") return tools.api.scene(id);
    throw error;
  }
}

async function hashAll(
  files: readonly SceneFile[],
  { hash, onStep, signal }: UploadTools,
): Promise<{ planned: PlannedFile[]; bySha256: Map<string, SceneFile> }> {
  const totalBytes = files.reduce((sum, file) => sum + file.sizeBytes, 0);
  let doneBytes = 0;
  const planned: PlannedFile[] = [];
  const bySha256 = new Map<string, SceneFile>();
  onStep({ what: "hash", doneBytes, totalBytes, numKnown: 0 });
  for (const file of files) {
    signal.throwIfAborted();
    const sha256 = await hash(await file.read());
    planned.push({ path: file.path, size: file.sizeBytes, sha256 });
    // Two files with the same bytes are one upload.
    bySha256.set(sha256, file);
    doneBytes += file.sizeBytes;
    onStep({ what: "hash", doneBytes, totalBytes, numKnown: 0 });
  }
  return { planned, bySha256 };
}

/** Return a function that repeats an action while the server does not answer, with growing pauses, until `signal`. */
function patience(
  { signal, wait = pause }: UploadTools,
  onWait: () => void = () => {},
): <T>(action: () => Promise<T>) => Promise<T> {
  return async (action) => {
    for (let pauseMs = 500; ; pauseMs = Math.min(2 * pauseMs, longestPauseMs)) {
      signal.throwIfAborted();
      try {
        return await action();
      } catch (error) {
        if (!(error instanceof Unreachable || (error instanceof Refused && isPassing(error)))) throw error;
      }
      onWait();
      await wait(pauseMs, signal);
    }
  };
}

function isPassing(refused: Refused): boolean {
  return refused.retryable && [408, 502, 503, 504].includes(refused.status);
}
