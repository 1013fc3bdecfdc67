/** Hashes files in a worker, so that the page stays responsive. */

import { sha256Hex } from "../bundle/sha256.js";
import type { HashAnswer, HashRequest } from "./hashing.js";

addEventListener("message", async (message: MessageEvent<HashRequest>) => {
  const { id, blob } = message.data;
  let answer: HashAnswer;
  try {
    answer = { id, sha256: await sha256Hex(new Uint8Array(await blob.arrayBuffer())) };
  } catch (error) {
    answer = { id, fault: error instanceof Error ? error.message : String(error) };
  }
  postMessage(answer);
});
