/** Hashes files in a worker, so that the page stays responsive. */

import { sha256Hex } from "../page/buffers.js";
import { messageOf } from "../page/fault.js";

export type HashRequest = { readonly id: number; readonly blob: Blob };
export type HashAnswer =
  | { readonly id: number; readonly sha256: string }
  | { readonly id: number; readonly fault: string };

addEventListener("message", async (message: MessageEvent<HashRequest>) => {
  const { id, blob } = message.data;
  let answer: HashAnswer;
  try {
    answer = { id, sha256: await sha256Hex(new Uint8Array(await blob.arrayBuffer())) };
  } catch (error) {
    answer = { id, fault: messageOf(error) };
  }
  postMessage(answer);
});
