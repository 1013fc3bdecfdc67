/** onnxruntime-web for graphics hardware: 7 MB to fetch, loaded when it is first needed. */

import type { Runtime } from "./onnxGraphs.js";

/** Load the runtime of the provider "webgpu". */
export async function loadWebgpu(): Promise<Runtime> {
  return import("onnxruntime-web/webgpu");
}
