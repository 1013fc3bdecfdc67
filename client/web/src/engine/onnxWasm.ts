/** onnxruntime-web for processors: 4 MB to fetch, loaded when it is first needed. */

import type { Runtime } from "./onnxGraphs.js";

/** Load the runtime of the provider "wasm". */
export async function loadWasm(): Promise<Runtime> {
  return import("onnxruntime-web/wasm");
}
