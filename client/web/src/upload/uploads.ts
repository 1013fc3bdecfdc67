/** The uploads of this tab; they continue while the visitor is in other views. */

import { Questions } from "../page/workers.js";
import type { Api, Scene } from "../page/rest.js";
import type { Candidate } from "./collect.js";
import type { HashAnswer, HashRequest } from "./hashWorker.js";
import { type Hash, type UploadStep, upload } from "./upload.js";

/** One upload and how far it is. */
export type Running = {
  readonly name: string;
  /** The scene whose upload it continues; null: a new one. */
  readonly sceneId: string | null;
  readonly step: UploadStep;
  readonly done: Promise<Scene>;
  readonly stop: () => void;
};

export type Uploads = ReturnType<typeof createUploads>;

/** Start the worker that hashes files; `close` ends it. */
function startHashing(): { hash: Hash; close: () => void } {
  const questions = new Questions<HashRequest, HashAnswer>(
    new Worker(new URL("./hashWorker.js", import.meta.url), { type: "module" }),
  );
  const hash: Hash = async (blob) => {
    const answer = await questions.ask({ blob });
    if ("fault" in answer) throw new Error(answer.fault);
    return answer.sha256;
  };
  return { hash, close: () => questions.close() };
}

/** Return the uploads of a tab. */
export function createUploads(api: Api) {
  const listeners = new Set<() => void>();
  const running = new Map<number, Running>();
  let number = 0;
  const tell = () => {
    for (const listener of listeners) listener();
  };

  // Leaving the page ends them: the browser asks first.
  addEventListener("beforeunload", (event) => {
    if (running.size > 0) event.preventDefault();
  });

  return {
    listen: (listener: () => void): (() => void) => {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
    all: (): Running[] => [...running.values()],
    /** Start to send a candidate as a new scene, or continue the upload of one. */
    begin: (candidate: Candidate, sceneId: string | null): Running => {
      number += 1;
      const mine = number;
      const controller = new AbortController();
      const { hash, close } = startHashing();
      const onStep = (step: UploadStep) => {
        const before = running.get(mine);
        if (before !== undefined) running.set(mine, { ...before, step });
        tell();
      };
      const done = upload(candidate, { api, hash, onStep, signal: controller.signal }, sceneId).finally(
        () => {
          close();
          running.delete(mine);
          tell();
        },
      );
      const one: Running = {
        name: candidate.name,
        sceneId,
        step: { what: "hash", doneBytes: 0, totalBytes: 0, numKnown: 0 },
        done,
        stop: () => controller.abort(new DOMException("stopped by the visitor", "AbortError")),
      };
      running.set(mine, one);
      tell();
      return one;
    },
  };
}
