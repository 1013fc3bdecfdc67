/** The page's side of the worker that hashes files. */

import { Questions } from "../page/questions.js";

export type HashRequest = { readonly id: number; readonly blob: Blob };
export type HashAnswer =
  | { readonly id: number; readonly sha256: string }
  | { readonly id: number; readonly fault: string };

/** Return the SHA-256 of a file's bytes, lower-case hexadecimal; rejects where they cannot be read. */
export type Hash = (blob: Blob) => Promise<string>;

/** Start a worker; `close` ends it. */
export function startHashing(): { hash: Hash; close: () => void } {
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
