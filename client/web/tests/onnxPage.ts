/**
 * The page that tests/support/engine_page.py opens in a browser: the engine's two readers of a bundle's networks, with
 * arrays as base64 text of little-endian float32 numbers.
 */

import { openBundle } from "../src/bundle/manifest.js";
import { FusedCache, packFastCache } from "../src/engine/fusedCache.js";
import { type OnnxGraph, openGraph, type Provider } from "../src/engine/onnxGraphs.js";
import { loadWebgpu, withoutHalves } from "./onnxWebgpu.js";

type Arrays = Record<string, string>;

const graphs = new Map<string, OnnxGraph>();
const caches = new Map<string, FusedCache>();

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
      runtime: await (provider === "webgpu" ? loadWebgpu() : import("onnxruntime-web/wasm")),
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

/** Pack and compile the fast cache of the bundle in a folder beside the page; `light` adds its radiance. */
async function fuse(name: string, path: string, light: string, folder: string): Promise<number> {
  const { manifest, read } = await openBundle({
    paths: null,
    read: (file: string) => fetched(`${folder}/${file}`),
  });
  const packed = packFastCache(manifest, await read(path), await read("models/weights.bin"), light);
  const device = await (await adapter()).requestDevice();
  device.addEventListener("uncapturederror", (event) => console.error(event.error.message));
  const cache = await FusedCache.create(device, packed);
  caches.set(name, cache);
  return cache.answerWidth;
}

async function runFused(name: string, rays: string): Promise<Arrays> {
  const found = await caches.get(name)!.run(fromText(rays));
  return {
    opacity: toText(found.opacity),
    distance: toText(found.distance),
    ...(found.radianceRgb === null ? {} : { radiance: toText(found.radianceRgb) }),
  };
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

async function timeFused(name: string, rays: string, times: number): Promise<number> {
  const values = fromText(rays);
  return shortest(() => caches.get(name)!.run(values), times);
}

Object.assign(window, { engine: { open, run, fuse, runFused, time, timeFused } });
