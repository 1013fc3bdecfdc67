/**
 * The page that tests/support/engine_page.py opens in a browser: the engine's reader of a bundle's networks, with
 * arrays as base64 text of little-endian float32 numbers.
 */

import { type OnnxGraph, openGraph, type Provider } from "../src/engine/onnxGraphs.js";
import { withoutHalves } from "../src/engine/onnxModel.js";
import { openCache } from "../src/refine/tracer.js";
import { openBundle } from "../src/bundle/manifest.js";

type Arrays = Record<string, string>;

const graphs = new Map<string, OnnxGraph>();

async function fetched(path: string): Promise<Uint8Array<ArrayBuffer>> {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return new Uint8Array(await answer.arrayBuffer());
}

function fromText(text: string): Float32Array<ArrayBuffer> {
  return new Float32Array(Uint8Array.from(atob(text), (character) => character.charCodeAt(0)).buffer);
}

function toText(values: Float32Array): string {
  const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  let text = "";
  for (let at = 0; at < bytes.length; at += 8192)
    text += String.fromCharCode(...bytes.subarray(at, at + 8192));
  return btoa(text);
}

async function adapter(): Promise<GPUAdapter> {
  const found = await navigator.gpu?.requestAdapter();
  if (!found) throw new Error("this browser has no WebGPU");
  return found;
}

/** Open a graph of the bundle beside the page under a name. */
async function open(name: string, path: string, provider: Provider, outputs?: string[]): Promise<boolean> {
  const halves = provider === "wasm" || (await adapter()).features.has("shader-f16");
  const [model, weights] = [await fetched(`bundle/${path}`), await fetched("bundle/models/weights.bin")];
  const stored = halves ? { model, weights } : withoutHalves(model, weights);
  graphs.set(
    name,
    await openGraph(stored.model, stored.weights, {
      provider,
      runtime: await (provider === "webgpu"
        ? import("onnxruntime-web/webgpu")
        : import("onnxruntime-web/wasm")),
      wasmFolder: new URL("ort/", location.href).href,
      ...(outputs === undefined ? {} : { outputs }),
    }),
  );
  return halves;
}

async function run(name: string, inputs: Arrays, widths: Record<string, number>): Promise<Arrays> {
  const values = Object.fromEntries(Object.entries(inputs).map(([key, text]) => [key, fromText(text)]));
  const found = await graphs.get(name)!.run(values, widths);
  return Object.fromEntries(Object.entries(found).map(([key, array]) => [key, toText(array)]));
}

/** Return what the tracer of the refinement finds with a backend, and the backend that it took. */
async function trace(path: string, backend: "cache" | "webgpu" | "wasm", rays: string): Promise<Arrays> {
  const { manifest, read } = await openBundle({
    paths: null,
    read: (file: string) => fetched(`bundle/${file}`),
  });
  const files = { manifest, model: await read(path), weights: await read("models/weights.bin") };
  // The packager of the pages puts these files beside its modules.
  for (const { env } of await Promise.all([
    import("onnxruntime-web/webgpu"),
    import("onnxruntime-web/wasm"),
  ])) {
    env.wasm.wasmPaths = new URL("ort/", location.href).href;
  }
  const { tracer, note } = await openCache(files, backend);
  const { opacity, distance } = await tracer.trace(fromText(rays));
  return { opacity: toText(opacity), distance: toText(distance), backend: tracer.backend, note };
}

/** Return the shortest of `times` durations of a task, in milliseconds; it runs once before. */
async function shortest(task: () => Promise<unknown>, times: number): Promise<number> {
  await task();
  let found = Number.POSITIVE_INFINITY;
  for (let i = 0; i < times; i++) {
    const started = performance.now();
    await task();
    found = Math.min(found, performance.now() - started);
  }
  return found;
}

async function time(
  name: string,
  inputs: Arrays,
  widths: Record<string, number>,
  times: number,
): Promise<number> {
  const values = Object.fromEntries(Object.entries(inputs).map(([key, text]) => [key, fromText(text)]));
  return shortest(() => graphs.get(name)!.run(values, widths), times);
}

Object.assign(window, { engine: { open, run, trace, time } });
